"""Waterfall of the gap: the error of free runs after each effect that was added, down to the noise floor."""

from typing import TYPE_CHECKING

from edge.diagnosis.diagnosis_document import DiagnosisDocument, Role
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
from edge.diagnosis.report.wording import ROLES, step_error, step_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROW_IN, BORDER_IN = 0.45, 1.1
WIDE = 30.0  # times the smallest error: beyond it on a logarithmic axis
BELOW = 0.41  # rows from a bar's middle down to that of the training runs


def gap_picture(document: DiagnosisDocument) -> Picture | None:
    """None where there is no step to show."""
    steps = document.get("waterfall", [])
    every: tuple[Role, ...] = ("test", "train")
    roles = [role for role in every if steps and all(step_error(step, role) is not None for step in steps)]
    if len(steps) < 2 or not roles:
        return None
    role = roles[0]
    names, errors = step_names(steps), [step_error(step, role) or 0.0 for step in steps]
    with style():
        figure = new_figure(ROW_IN * len(steps) + BORDER_IN)
        axes = figure.subplots()
        trained = [step["train_rmse_k"] or 0.0 for step in steps] if roles == ["test", "train"] else []
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
        told = ", ".join(f"{name} {kelvin(error)} K" for name, error in zip(names, errors, strict=True))
        title = f"Error of free runs after each step, {ROLES[role]}: {told}"
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
