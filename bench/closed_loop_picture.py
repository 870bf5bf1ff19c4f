"""One controller's day: what was asked for, what was measured, what it planned and what it drove."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE_IN = (7.2, 8.2)  # narrow and with large letters: it is read on a phone, too
LETTERS = 13
HEIGHTS = (2.6, 0.45, 1.0, 2.2)  # the day's temperature, fan and heater, and two moments
ZOOM_H = 0.75  # length of a moment
LEAD_H = 0.12  # of which before the change of the reference
PLANS_AT_MIN = (-1, 3, 12, 24)  # after the change: plans that are shown
AIR, REFERENCE, ROOM, PLAN = "#c0392b", "black", "#2874a6", "#1e8449"


class DayColumns(Protocol):
    """The columns of a day, and its plans."""

    @property
    def controller(self) -> str: ...
    @property
    def columns(self) -> Mapping[str, NDArray[np.float64]]: ...
    @property
    def plans(self) -> Sequence[Sequence[float]]: ...


def draw(day: DayColumns, out: Path) -> None:
    """Draw the day, and the plans around its largest step up and its largest step down."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context({"font.size": LETTERS}):
        figure = Figure(figsize=SIZE_IN, layout="constrained")
        axes = figure.subplot_mosaic(
            [["day", "day"], ["fan", "fan"], ["heater", "heater"], ["up", "down"]], height_ratios=HEIGHTS
        )
        _day(axes, day)
        reference = day.columns["reference_c"]
        steps = np.diff(reference, prepend=reference[0])
        for name, row in (("up", int(steps.argmax())), ("down", int(steps.argmin()))):
            _moment(axes[name], day, row, f"a step {name}, and its plans")
        axes["up"].set_ylabel("°C")
        figure.savefig(out, dpi=110)


def _hours(day: DayColumns) -> NDArray[np.float64]:
    time_s = day.columns["time_s"]
    return np.asarray((time_s - time_s[0]) / 3600.0)


def _temperatures(axis: "Axes", day: DayColumns, width: float) -> None:
    hours, columns = _hours(day), day.columns
    axis.step(hours, columns["reference_c"], "--", where="post", color=REFERENCE, lw=1.6, label="reference")
    axis.plot(hours, columns["temp_air_c"], color=AIR, lw=width, label="air")
    axis.grid(alpha=0.3)


def _day(axes: Mapping[str, "Axes"], day: DayColumns) -> None:
    hours, columns = _hours(day), day.columns
    _temperatures(axes["day"], day, 1.3)
    axes["day"].plot(hours, columns["temp_ambient_c"], color=ROOM, lw=1.2, label="room")
    axes["day"].set_title(f"A day with {day.controller}, the default", loc="left")
    axes["day"].legend(loc="upper left", ncols=3, fontsize="small", frameon=False)
    low, high = axes["day"].get_ylim()
    axes["day"].set_ylim(low, high + 0.2 * (high - low))  # room for the legend
    axes["fan"].fill_between(hours, columns["fan_on"], step="post", color="#117864", lw=0)
    axes["fan"].set_yticks([0.5], ["fan"])
    axes["heater"].fill_between(hours, columns["heater_duty"], step="post", color="#ca6f1e", lw=0)
    axes["heater"].set_ylim(0.0, 1.05)
    axes["heater"].set_xlabel("hour of the day")
    for name, label in (("day", "°C"), ("heater", "heater")):
        axes[name].set_ylabel(label)
    for name in ("day", "fan", "heater"):
        axes[name].set_xlim(0.0, hours[-1])
        axes[name].set_xticks(np.arange(0.0, hours[-1] + 0.1, 3.0))
        axes[name].tick_params(labelbottom=name == "heater")


def _moment(axis: "Axes", day: DayColumns, row: int, title: str) -> None:
    """Draw the measurements around a row, and the controller's expectations at some of its steps."""
    hours, columns = _hours(day), day.columns
    step_h = float(np.median(np.diff(hours)))
    _temperatures(axis, day, 1.6)
    label = "plan"
    for minutes in PLANS_AT_MIN:
        at = row + round(minutes / 60.0 / step_h)
        if 0 <= at < len(day.plans) and len(day.plans[at]):
            plan = [columns["temp_air_c"][at], *day.plans[at]]
            times = hours[at] + step_h * np.arange(len(plan))
            axis.plot(times, plan, "o-", color=PLAN, ms=3.5, lw=1.2, alpha=0.8, label=label)
            label = "_nolegend_"
    begin = hours[row] - LEAD_H
    axis.set_xlim(begin, begin + ZOOM_H)
    shown = (hours >= begin) & (hours <= begin + ZOOM_H)
    values = np.concatenate([columns["temp_air_c"][shown], columns["reference_c"][shown]])
    axis.set_ylim(np.nanmin(values) - 0.5, np.nanmax(values) + 0.5)
    ticks = np.arange(np.ceil(begin * 4) / 4, begin + ZOOM_H, 0.25)
    axis.set_xticks(ticks, [f"{int(tick)}:{round(60 * (tick % 1)):02d}" for tick in ticks])
    axis.set_title(title, loc="left", fontsize="medium")
    axis.legend(loc="best", fontsize="small", frameon=False)
