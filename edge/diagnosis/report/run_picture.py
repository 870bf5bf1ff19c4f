"""A run: measured, and the twin before and after; what was done to the box below, on one time axis."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from edge.diagnosis.report.number_text import kelvin
from edge.diagnosis.report.picture import (
    AFTER,
    BEFORE,
    FAN,
    HEATER,
    INK,
    PLAIN,
    Picture,
    drawable,
    legend_above,
    new_figure,
    style,
    svg,
    time_axis,
)
from edge.diagnosis.report.story import Floats, Trace, worst_stretch

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PANEL_IN = {"air": 1.9, "residual": 0.8, "fan": 0.32, "duty": 0.5}
BORDER_IN = 1.0
LONGEST_S = 86400.0  # of a longer run only a part can be read
TITLE_LETTERS = 40
MANY_ROWS = 3000  # from here on a filled panel is stored as dots
_ROLES = {"test": "held out", "train": "training"}


def run_picture(trace: Trace, errors: Sequence[float | None], adds: bool) -> Picture:
    """errors : RMSE before and after [K];  adds : whether after is another twin than before"""
    known = {
        "air": True,
        "residual": trace.scored and trace.before is not None,
        "fan": moves(trace.inputs.get("fan_on")),
        "duty": moves(trace.inputs.get("heater_duty")),
    }
    panels = {name: height for name, height in PANEL_IN.items() if known[name]}
    title = f"{drawable(trace.name, TITLE_LETTERS)} ({_ROLES.get(trace.role, trace.role)})"
    # A month in one picture is a black band; the worst day shows what goes wrong.
    whole, trace = trace, worst_stretch(trace, LONGEST_S)
    with style():
        figure = new_figure(sum(panels.values()) + BORDER_IN)
        drawn = figure.subplots(
            len(panels), 1, sharex=True, squeeze=False, height_ratios=list(panels.values())
        )[:, 0]
        axes = dict(zip(panels, drawn, strict=True))
        divisor, unit = time_axis(float(trace.time_s[-1] - trace.time_s[0]))
        time = trace.time_s / divisor
        axes["air"].set_title(title)
        _draw_air(axes["air"], trace, time, adds)
        _draw_inputs(axes, trace, time, adds)
        drawn[-1].set_xlabel(f"time [{unit}]")
        drawn[-1].set_xlim(time[0], max(time[-1], time[0] + 1e-9))
        figure.align_ylabels(list(drawn))
        shown = " Shown: the day with the largest error." if trace is not whole else ""
        told = "measured, and free runs of the twin before and after" if adds else "measured, and a free run"
        return Picture(svg(figure), f"{title}: air {told}", _caption(trace, errors, adds) + shown)


def limits(
    measured: Floats | None, after: Floats | None, before: Floats | None
) -> tuple[float, float] | None:
    """Lowest and highest temperature to show: all that was measured and all of after; of before no more than
    as much again. None where nothing is known."""
    firm = _finite(measured, after)
    loose = _finite(before)
    if not len(firm):
        firm = loose
    if not len(firm):
        return None
    low, high = float(firm.min()), float(firm.max())
    room = max(high - low, 1.0)
    if len(loose):
        low, high = max(min(low, loose.min()), low - room), min(max(high, loose.max()), high + room)
    edge = 0.04 * (high - low) or 0.5
    return low - edge, high + edge


def _draw_air(axes: "Axes", trace: Trace, time: Floats, adds: bool) -> None:
    if trace.measured is not None:
        axes.plot(
            time, trace.measured, color=INK, alpha=0.33, lw=4.2, label="measured", solid_capstyle="round"
        )
    if trace.before is not None:
        label = "twin before" if adds else "twin"
        axes.plot(
            time, trace.before, color=BEFORE if adds else AFTER, lw=1.5, ls="--" if adds else "-", label=label
        )
    if trace.after is not None and adds:
        axes.plot(time, trace.after, color=AFTER, lw=1.6, label="twin after")
    room = trace.inputs.get("temp_ambient")
    if room is not None:
        axes.plot(time, room, color=PLAIN, lw=0.9, ls=":", label="room")
    found = limits(_finite(trace.measured, room), trace.after, trace.before)
    if found is not None:
        axes.set_ylim(*found)
    axes.set_ylabel("air [°C]")
    legend_above(axes, 4)


def _draw_inputs(axes: Mapping[str, "Axes"], trace: Trace, time: Floats, adds: bool) -> None:
    if "residual" in axes:
        axes["residual"].axhline(0.0, color=INK, lw=0.7, alpha=0.6)
        for when, colour in (("before", BEFORE if adds else AFTER), *((("after", AFTER),) if adds else ())):
            if (residual := trace.residual(when)) is not None:
                axes["residual"].plot(time, residual, color=colour, lw=1.1)
        axes["residual"].set_ylim(*residual_limits(trace))
        axes["residual"].set_ylabel("measured\n− twin [K]")
    if "fan" in axes:
        _steps(axes["fan"], time, trace.inputs["fan_on"], FAN)
        axes["fan"].set_yticks([0, 1], ["off", "on"])
        axes["fan"].set_ylabel("fan")
    if "duty" in axes:
        _steps(axes["duty"], time, trace.inputs["heater_duty"], HEATER)
        axes["duty"].set_ylabel("heater\nduty")


def residual_limits(trace: Trace) -> tuple[float, float]:
    """Lowest and highest residual to show; what is further off than the measurements reach is not."""
    reach = 1.0 if trace.measured is None else max(float(np.ptp(_finite(trace.measured))), 1.0)
    joined = _finite(trace.residual("before"), trace.residual("after"))
    low, high = max(joined.min(initial=0.0), -reach), min(joined.max(initial=0.0), reach)
    room = 0.05 * (high - low) or 0.1
    return low - room, high + room


def _steps(axes: "Axes", time: Floats, values: Floats, colour: str) -> None:
    dots = len(time) > MANY_ROWS
    axes.fill_between(time, values, step="post", color=colour, alpha=0.45, lw=0, rasterized=dots)
    axes.step(time, values, where="post", color=colour, lw=0.9, rasterized=dots)
    axes.set_ylim(-0.04, 1.1)


def moves(values: Floats | None) -> bool:
    """Return whether a series changes."""
    return values is not None and float(np.ptp(_finite(values))) > 0.0


def _finite(*series: Floats | None) -> Floats:
    known = [np.asarray(values)[np.isfinite(values)] for values in series if values is not None]
    return np.concatenate(known) if known else np.empty(0)


def _caption(trace: Trace, errors: Sequence[float | None], adds: bool) -> str:
    free = "Free runs: the twin is given the inputs and the first rows, and no other temperature."
    before, after = errors
    if before is None and not trace.scored:
        return (
            "Free runs from the first rows. Later temperatures were not given, so there is no error to tell."
        )
    if before is None:
        return free
    if not adds or after is None:
        return f"A free run from the first rows. RMSE {kelvin(before)} K."
    return f"{free} RMSE {kelvin(before)} K before, {kelvin(after)} K after."
