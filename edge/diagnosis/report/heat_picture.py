"""Residual heat over the variable that explains most of it, before and after."""

from typing import TYPE_CHECKING

import numpy as np

from edge.diagnosis.report.number_text import percent
from edge.diagnosis.report.picture import FAN, HEATER, INK, Picture, new_figure, style, svg
from edge.diagnosis.report.story import Floats, Story, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from numpy.typing import NDArray

BINS = 9
SWITCH_MIN = 45.0  # longest time since a change of the duty that is looked at [min]
STEP = 0.04  # smallest change of the duty that is one; the heater moves in steps of 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Variable:
    """A quantity, and two groups of its rows. x : [N], NaN where not defined;  group : [N], 0 or 1"""

    key: str
    label: str
    x: Floats
    group: NDArray[np.intp]
    groups: tuple[str, str]


def variables(traces: Sequence[Trace]) -> list[Variable]:
    """All that are known of these runs, their rows one after another; those named like a signal first.

    The heat of a row was missing since the row before: it goes with the inputs that were held from there.
    """
    found = []
    fan = _series(traces, lambda one: _last(one.fan))
    group = (np.nan_to_num(fan, nan=0.0) > 0.5).astype(np.intp)
    for key, label, of in _SIGNALS:
        x = _series(traces, of)
        if np.isfinite(x).any():
            found.append(Variable(key, label, x, group, ("fan off", "fan on")))
    since, rising = (np.concatenate(parts) for parts in zip(*map(_since_change, traces), strict=True))
    if np.isfinite(since).any():
        groups = ("after a step down", "after a step up")
        found.append(
            Variable("switch", "time since the duty changed [min]", since, rising.astype(np.intp), groups)
        )
    return found


def explained_share(variable: Variable, heat: Floats) -> float:
    """Share of the variance of `heat` [N] that means over bins and groups explain, less what chance would."""
    cells = [heat[rows] for rows, _ in bins(variable, heat)]
    rows = sum(map(len, cells))
    if rows < 4 * max(len(cells), 1):
        return 0.0
    values = np.concatenate(cells)
    total = float(((values - values.mean()) ** 2).sum())
    within = sum(float(((cell - cell.mean()) ** 2).sum()) for cell in cells)
    return 0.0 if total == 0.0 else 1.0 - (within / (rows - len(cells))) / (total / (rows - 1))


def bins(variable: Variable, heat: Floats) -> list[tuple[NDArray[np.intp], int]]:
    """Rows of each cell with its group: bins of about as many rows each, without those of fewer than 3."""
    known = np.isfinite(variable.x) & np.isfinite(heat)
    if not known.any():
        return []
    edges = np.unique(np.quantile(variable.x[known], np.linspace(0.0, 1.0, BINS + 1)))
    place = np.clip(np.searchsorted(edges, variable.x, side="right") - 1, 0, max(len(edges) - 2, 0))
    cells = [
        (np.flatnonzero(known & (place == number) & (variable.group == group)), group)
        for group in (0, 1)
        for number in range(max(len(edges) - 1, 1))
    ]
    return [(rows, group) for rows, group in cells if len(rows) >= 3]


def _series(traces: Sequence[Trace], of: Callable[[Trace], Floats | None]) -> Floats:
    parts = [of(one) for one in traces]
    blanks = [np.full(len(one.time_s), np.nan) for one in traces]
    return np.concatenate([b if p is None else p for p, b in zip(parts, blanks, strict=True)])


def _last(values: Floats | None) -> Floats | None:
    """Return the values of the row before."""
    return None if values is None else np.append(np.nan, values[:-1])


def _difference(trace: Trace) -> Floats | None:
    known = trace.measured is not None and trace.ambient is not None
    return trace.measured - trace.ambient if known else None  # type: ignore[operator]  # both are known


def _since_change(trace: Trace) -> tuple[Floats, Floats]:
    """Minutes since the duty last changed, NaN before its first change and long after; whether it rose."""
    since, rising = np.full(len(trace.time_s), np.nan), np.zeros(len(trace.time_s))
    if trace.duty is None:
        return since, rising
    changes = np.flatnonzero(np.abs(np.diff(trace.duty)) > STEP) + 1
    last = np.searchsorted(changes, np.arange(len(since)), side="right") - 1
    rows = np.flatnonzero(last >= 0)
    begun = changes[last[rows]]
    since[rows] = (trace.time_s[rows] - trace.time_s[begun]) / 60.0
    rising[rows] = trace.duty[begun] > trace.duty[begun - 1]
    since[(since == 0.0) | (since > SWITCH_MIN)] = np.nan  # at 0 the change has not acted yet
    return since, rising


_SIGNALS: tuple[tuple[str, str, Callable[[Trace], Floats | None]], ...] = (
    ("difference", "air − room [K]", _difference),
    ("heater_duty", "heater duty [0..1]", lambda one: _last(one.duty)),
    ("temp_air", "air temperature [°C]", lambda one: one.measured),
    ("temp_ambient", "room temperature [°C]", lambda one: one.ambient),
    ("time", "time in the run [min]", lambda one: one.time_s / 60.0),
)


DOTS = 1500  # most rows drawn in a panel
COLOURS, MARKERS = (HEATER, FAN), ("o", "s")


def heat_picture(story: Story, adds: bool) -> Picture | None:
    """None where no run has residual heat. adds : whether after is another twin than before"""
    traces = [one for one in story.traces if one.residual_heat_before_w is not None]
    if not traces:
        return None
    heats = {when: _heat(traces, when) for when in (("before", "after") if adds else ("before",))}
    # One condition for both panels, that of the twin before: two would not show what was closed.
    chosen = _choose(story, traces, heats["before"])
    if chosen is None:
        return None
    shown = {when: heat for when, heat in heats.items() if np.isfinite(heat).any()}
    with style():
        figure = new_figure(2.9)
        panels = figure.subplots(1, len(shown), sharey=True, sharex=True, squeeze=False)[0]
        for axes, (when, heat) in zip(panels, shown.items(), strict=True):
            _draw(axes, chosen, heat)
            axes.set_title(f"Residual heat {when}" if len(shown) > 1 else "Residual heat")
        figure.supxlabel(chosen.label, fontsize="medium")
        panels[0].set_ylabel("residual heat [W]")
        panels[0].set_ylim(*_limits(chosen, shown))
        handles, labels = panels[0].get_legend_handles_labels()
        if handles:
            figure.legend(handles, labels, loc="outside upper right", ncols=2)
        share = percent(max(explained_share(chosen, heats["before"]), 0.0))
        return Picture(
            svg(figure),
            f"Residual heat over {chosen.label}",
            "Residual heat: what must be added to the twin's air to make it show what was measured; below 0"
            " the twin gains too much. Large marks: means with twice their standard error; they explain"
            f" {share} of the variance before.",
        )


def _choose(story: Story, traces: list[Trace], heat: Floats) -> Variable | None:
    """Return the variable that the diagnosis names, if it can be drawn, else the one that explains most."""
    known = variables(traces)
    by_key = {one.key: one for one in known}
    for name in story.document["depends_on"]:
        if name in by_key:
            return by_key[name]
    return max(known, key=lambda one: explained_share(one, heat), default=None)


def _heat(traces: list[Trace], when: str) -> Floats:
    parts = [one.residual_heat_before_w if when == "before" else one.residual_heat_after_w for one in traces]
    rows = [len(one.time_s) for one in traces]
    return np.concatenate([np.full(n, np.nan) if p is None else p for p, n in zip(parts, rows, strict=True)])


def _draw(axes: "Axes", variable: Variable, heat: Floats) -> None:
    axes.axhline(0.0, color=INK, lw=0.8, alpha=0.7)
    known = np.flatnonzero(np.isfinite(variable.x) & np.isfinite(heat))
    shown = known[:: max(1, len(known) // DOTS)]
    for group in (0, 1):
        rows = shown[variable.group[shown] == group]
        axes.plot(
            variable.x[rows], heat[rows], ".", ms=4.0, mew=0, color=COLOURS[group], alpha=0.4, rasterized=True
        )
        means = [_mean(variable.x[cell], heat[cell]) for cell, of in bins(variable, heat) if of == group]
        if means:
            x, mean, error = np.array(sorted(means)).T
            axes.errorbar(
                x,
                mean,
                2.0 * error,
                fmt="-" + MARKERS[group],
                color=COLOURS[group],
                ms=5.5,
                mec=INK,
                mew=0.6,
                lw=1.3,
                label=variable.groups[group],
            )


def _mean(x: Floats, heat: Floats) -> tuple[float, float, float]:
    return float(x.mean()), float(heat.mean()), float(heat.std(ddof=1) / np.sqrt(len(heat)))


def _limits(variable: Variable, heats: dict[str, Floats]) -> tuple[float, float]:
    """All means with their errors, and all dots but the farthest of a hundred."""
    values = np.concatenate([heat[np.isfinite(heat)] for heat in heats.values()])
    means = [
        _mean(variable.x[cell], heat[cell])[1:] for heat in heats.values() for cell, _ in bins(variable, heat)
    ]
    low = min(0.0, float(np.quantile(values, 0.01)), *(mean - 2.0 * error for mean, error in means))
    high = max(0.0, float(np.quantile(values, 0.99)), *(mean + 2.0 * error for mean, error in means))
    room = 0.08 * (high - low) or 1.0
    return low - room, high + room
