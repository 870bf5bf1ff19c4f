"""The pictures of a report and their places: a run, the residual's two standard plots, the gap."""

import importlib.util
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from edge.diagnosis.diagnosis_document import DiagnosisDocument
from edge.diagnosis.report.number_text import kelvin
from edge.diagnosis.report.picture import (
    AFTER,
    BEFORE,
    INK,
    PLAIN,
    Picture,
    legend_above,
    new_figure,
    style,
    svg,
)
from edge.diagnosis.report.residual_plots import residual_plots
from edge.diagnosis.report.run_picture import run_picture
from edge.diagnosis.report.story import Story, Trace
from edge.diagnosis.report.wording import (
    ROLES,
    is_changed,
    run_errors,
    scored_role,
    step_k,
    step_names,
    steps_text,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROW_IN, BORDER_IN = 0.45, 1.1
WIDE = 30.0  # times the smallest error: beyond it on a logarithmic axis
BELOW = 0.41  # rows from a bar's middle down to that of the training runs


def gap_picture(document: DiagnosisDocument) -> Picture | None:
    """None where there is no step to show."""
    steps, role = document.get("waterfall", []), scored_role(document)
    errors = [known for step in steps if (known := step_k(step, role)) is not None]
    if len(steps) < 2 or len(errors) < len(steps):
        return None
    names, trained = step_names(steps), [step["train_rmse_k"] or 0.0 for step in steps if role == "test"]
    with style():
        figure = new_figure(ROW_IN * len(steps) + BORDER_IN)
        axes = figure.subplots()
        floor = document["gap"]["noise_floor"][role]
        # One axis for bars, training runs and floor: whichever is least must be on it.
        low = error_axis(axes, [*errors, *trained, *([] if floor is None else [floor])])
        _draw(axes, names, errors, low)
        if trained:
            below = [row + BELOW for row in range(len(steps))]
            lengths = [max(error - low, 0.0) for error in trained]
            axes.barh(below, lengths, left=low, color=PLAIN, height=0.12, label="training runs")
        if floor is not None:
            axes.axvline(floor, color=INK, ls=(0, (4, 3)), lw=1.2, label=f"noise floor {kelvin(floor)} K")
        axes.set_title("The gap, step by step")
        axes.set_xlabel(f"RMSE of free runs, {ROLES[role]} [K]")
        if axes.get_legend_handles_labels()[1]:
            legend_above(axes, 2)
        title = f"Error of free runs after each step, {steps_text(document)}"
        return Picture(
            svg(figure), title, "Pale: what the step closed. Left of the dashed line is only noise."
        )


def error_axis(axes: "Axes", shown: list[float]) -> float:
    """Scale the axis of errors; bars begin at 0, or below the smallest where that would be invisible."""
    least, most = min(shown), max(shown)
    if not 0.0 < least < most / WIDE:
        axes.set_xlim(0.0, 1.18 * most)
        return 0.0
    low = 0.6 * least
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("")
    axes.set_xlim(low, most * (most / low) ** 0.18)
    return low


def _draw(axes: "Axes", names: list[str], errors: list[float], low: float) -> None:
    """Draw a bar per step, its end labelled, pale up to the end of the step before."""
    rows = range(len(names))
    colours = [BEFORE] + [AFTER] * (len(names) - 1)
    axes.barh(rows, [error - low for error in errors], left=low, color=colours, height=0.62, zorder=2)
    for row in rows[1:]:
        closed = max(errors[row - 1] - errors[row], 0.0)
        axes.barh(row, closed, left=errors[row], color=AFTER, alpha=0.18, height=0.62, zorder=2)
    for row in rows:
        end = max(errors[max(row - 1, 0) : row + 1])
        axes.annotate(f"{kelvin(errors[row])} K", (end, row), (5, 0), textcoords="offset points", va="center")
    axes.set_yticks(rows, names)
    axes.set_ylim(len(names) - 0.45, -0.5)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)


LEAST_ROWS = 3  # of a run that can be drawn


def pictures(story: Story) -> Mapping[str, tuple[Picture, ...]] | None:
    """By section of the page: run, residual, gap; None without matplotlib."""
    if importlib.util.find_spec("matplotlib") is None:
        return None
    story = replace(story, traces=tuple(one for one in story.traces if len(one.time_s) >= LEAST_ROWS))
    shown, adds = shown_run(story), is_changed(story.document)
    errors = {} if shown is None else run_errors(story.document, shown.role)
    gap = gap_picture(story.document)
    return {
        "run": () if shown is None else (run_picture(shown, errors.get(shown.name, (None, None)), adds),),
        "residual": tuple(residual_plots(story.traces)),
        "gap": () if gap is None else (gap,),
    }


def shown_run(story: Story) -> Trace | None:
    """Return the run that shows the gap best: held out, else of training, the worst; else a forecast."""
    known = [one for one in story.traces if one.before is not None]
    return max(
        known, key=lambda one: (one.scored and one.role == "test", one.scored, one.rmse_k()), default=None
    )
