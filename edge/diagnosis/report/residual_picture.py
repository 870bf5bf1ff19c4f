"""Residuals in time, of all runs, end to end: in kelvins, and as the heat that would explain them."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from edge.diagnosis.report.picture import (
    AFTER,
    BEFORE,
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
from edge.diagnosis.report.story import Floats, Story, Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIDES = ("before", "after")
SMOOTH_ROWS = 15  # of the mean that is drawn of a heat
LETTERS = 65  # of the names above the panel that its width has room for


def residual_picture(story: Story, adds: bool) -> Picture | None:
    """None where no run has temperatures to compare with. adds : whether after is another twin than before"""
    traces = [one for one in story.traces if one.scored and one.before is not None]
    if not traces:
        return None
    with style():
        figure = new_figure(2.5)
        axes = figure.subplots()
        _end_to_end(
            axes,
            traces,
            lambda time, trace, first: draw_residuals(axes, time, trace, adds, labelled=first),
        )
        axes.set_ylim(*residual_limits(traces))
        axes.set_ylabel("measured − twin [K]")
        axes.set_title("Residuals of free runs")
        legend_above(axes, 3, room_pt=12.0)
        held_out = " Shaded: held out." if any(one.role == "test" for one in traces) else ""
        return Picture(
            svg(figure),
            "Residuals of free runs in time, all runs end to end",
            f"What remains should be noise around 0.{held_out}",
        )


def heat_course_picture(story: Story) -> Picture | None:
    """Heat that has no name, in W over time; None where everything has one, or no run has such heat."""
    traces = [one for one in story.traces if one.residual_heat_before_w is not None]
    if story.document["verdict"] != "unknown" or not traces:
        return None
    with style():
        figure = new_figure(2.3)
        axes = figure.subplots()
        _end_to_end(axes, traces, lambda time, trace, _: _draw_heat(axes, time, trace))
        axes.set_ylabel("unexplained heat [W]")
        axes.set_title("The heat that the twin lacks, over time", pad=17)
        return Picture(
            svg(figure),
            "Unexplained heat in watts over time, all runs end to end",
            f"Line: mean over {SMOOTH_ROWS} rows; band: twice its standard error. Above 0 the box gains what"
            " the twin does not know, below 0 it loses it.",
        )


def _draw_heat(axes: "Axes", time: Floats, trace: Trace) -> None:
    heat = trace.residual_heat_before_w
    if heat is None:
        return
    known = np.isfinite(heat)
    window = np.ones(min(SMOOTH_ROWS, len(heat)))
    count = np.maximum(np.convolve(known, window, "same"), 1.0)
    mean = np.convolve(np.where(known, heat, 0.0), window, "same") / count
    square = np.convolve(np.where(known, (heat - mean) ** 2, 0.0), window, "same") / count
    error = 2.0 * np.sqrt(square / count)
    axes.fill_between(time, mean - error, mean + error, color=BEFORE, alpha=0.25, lw=0)
    axes.plot(time, mean, color=BEFORE, lw=1.2)


def _end_to_end(axes: "Axes", traces: Sequence[Trace], draw: Callable[[Floats, Trace, bool], None]) -> None:
    """Draw runs one after another. draw : receives the times of the axis,
    the run, and whether it is the first
    """
    lengths = [float(one.time_s[-1] - one.time_s[0] + _step(one)) for one in traces]
    divisor, unit = time_axis(sum(lengths))
    begins = np.concatenate([[0.0], np.cumsum(lengths)])
    for number, (trace, begin, end) in enumerate(zip(traces, begins[:-1], begins[1:], strict=True)):
        draw((trace.time_s - trace.time_s[0] + begin) / divisor, trace, number == 0)
        _frame(axes, trace, begin / divisor, end / divisor, (end - begin) / begins[-1])
    axes.axhline(0.0, color=INK, lw=0.8, alpha=0.7)
    axes.set_xlim(0.0, begins[-1] / divisor)
    axes.set_xlabel(f"time, runs end to end [{unit}]")


def draw_residuals(axes: "Axes", time: Floats, trace: Trace, adds: bool, labelled: bool = False) -> None:
    """Residuals of a free run, before and, where it is another twin, after."""
    for when, colour in (("before", BEFORE if adds else AFTER), *((("after", AFTER),) if adds else ())):
        residual = trace.residual(when)
        if residual is not None:
            label = (f"twin {when}" if adds else "twin") if labelled else None
            axes.plot(time, residual, color=colour, lw=1.1, label=label)


def _frame(axes: "Axes", trace: Trace, begin: float, end: float, share: float) -> None:
    """Mark a run's end, whether it was held out, and its name where there is space."""
    axes.axvline(end, color=PLAIN, lw=0.7, alpha=0.8)
    if trace.role == "test":
        axes.axvspan(begin, end, color=PLAIN, alpha=0.16, lw=0)
    if len(trace.name) <= LETTERS * share:
        axes.annotate(
            drawable(trace.name, LETTERS),
            (0.5 * (begin + end), 1.0),
            (0, 3),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            fontsize=7.6,
        )


def residual_limits(traces: Sequence[Trace]) -> tuple[float, float]:
    """Lowest and highest residual to show; what is further off than the measurements reach is not."""
    known = [part for one in traces for when in SIDES if (part := one.residual(when)) is not None]
    reach = max([float(np.ptp(_finite(one.measured))) for one in traces if one.measured is not None] + [1.0])
    joined = _finite(np.concatenate(known)) if known else np.zeros(1)
    low, high = max(joined.min(initial=0.0), -reach), min(joined.max(initial=0.0), reach)
    room = 0.05 * (high - low) or 0.1
    return low - room, high + room


def _finite(values: Floats) -> Floats:
    return values[np.isfinite(values)]


def _step(trace: Trace) -> float:
    return float(np.median(np.diff(trace.time_s))) if len(trace.time_s) > 1 else 0.0
