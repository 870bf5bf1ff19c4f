"""The pictures of a report and their places: gap, gains of the candidates, autocorrelation; other files
draw runs.
"""

import importlib.util
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from edge.diagnosis.diagnosis_document import WHENS, DiagnosisDocument, Role
from edge.diagnosis.report.heat_picture import heat_picture
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
from edge.diagnosis.report.residual_picture import heat_course_picture, residual_picture
from edge.diagnosis.report.run_picture import run_picture
from edge.diagnosis.report.story import Story, Trace
from edge.diagnosis.report.wording import ROLES, is_changed, step_error, step_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
from typing import TYPE_CHECKING

from edge.diagnosis.diagnosis_document import CandidateEntry, RoundEntry
from edge.diagnosis.report.number_text import nats
from edge.diagnosis.report.wording import join_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
from collections.abc import Sequence
from typing import TYPE_CHECKING

from edge.diagnosis.report.story import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes


LAGS = 40
LEAST_WHITE_ROWS = 20  # fewer tell nothing
LEAST_REACH = 0.4  # of the axis


def whiteness_picture(story: Story, adds: bool) -> Picture | None:
    """None where innovations are not known. adds : whether after is another twin than before

    Of the last twin alone: each has noise of its own, and one that lacks an effect may take that for noise.
    """
    every = [one.innovations_after if adds else one.innovations_before for one in story.traces]
    parts = [one for one in every if one is not None]
    rows = _rows(parts)
    if rows < LEAST_WHITE_ROWS:
        return None
    values = autocorrelation(parts)
    # Bartlett's band: autocorrelations of white noise have a standard deviation of 1/sqrt(rows).
    band = 1.96 / np.sqrt(rows)
    with style():
        figure = new_figure(2.4)
        axes = figure.subplots()
        axes.axhspan(-band, band, color=PLAIN, alpha=0.3, lw=0, label="95 % of white noise")
        axes.axhline(0.0, color=INK, lw=0.8, alpha=0.7)
        _draw_autocorrelation(axes, values, "twin after" if adds else "twin", _step_min(story.traces))
        axes.set_ylim(*_limits(values, band))
        axes.set_xlabel("lag [min]")
        axes.set_ylabel("autocorrelation")
        axes.set_title("Innovations: is anything left?")
        legend_above(axes, 2)
        return Picture(
            svg(figure),
            "Autocorrelation of the innovations",
            "Of all runs together. Where nothing is left to explain, almost all lie in the grey band.",
        )


def autocorrelation(parts: Sequence[Floats]) -> Floats:
    """Return the autocorrelation of several series together, at lags 1 to LAGS or a quarter of the longest.

    No lag crosses from a series to the next; what is missing is left out.
    """
    centred = [
        np.where(np.isfinite(part), part, np.nan) - np.nanmean(part[np.isfinite(part)])
        for part in parts
        if np.isfinite(part).any()
    ]
    variance = np.nanmean(np.concatenate(centred) ** 2)
    lags = min(LAGS, max(len(part) for part in centred) // 4)
    values = []
    for lag in range(1, lags + 1):
        products = np.concatenate([part[lag:] * part[:-lag] for part in centred])
        values.append(
            np.nanmean(products) / variance if variance > 0.0 and np.isfinite(products).any() else 0.0
        )
    return np.array(values)


def _draw_autocorrelation(axes: "Axes", values: Floats, label: str, step_min: float) -> None:
    lags = np.arange(1, len(values) + 1) * step_min
    axes.vlines(lags, 0.0, values, color=AFTER, lw=1.2)
    axes.plot(lags, values, "o", color=AFTER, ms=3.2, label=label)


def _limits(values: Floats, band: float) -> tuple[float, float]:
    """Return axis limits by which a small correlation looks small."""
    reach = max(LEAST_REACH, 1.15 * band, 1.1 * float(np.abs(values).max(initial=0.0)))
    return -reach, reach


def _rows(parts: Sequence[Floats]) -> int:
    return int(sum(np.isfinite(part).sum() for part in parts))


def _step_min(traces: Sequence[Trace]) -> float:
    steps = [float(np.median(np.diff(one.time_s))) for one in traces if len(one.time_s) > 1]
    return float(np.median(steps)) / 60.0 if steps else 1.0


ROUNDS, SHOWN = 4, 8  # more are in the table
BAR_IN, ROUND_IN, GAINS_BORDER_IN = 0.22, 0.38, 0.5
LEAST_NATS = 1.0  # the axis is linear below: such a gain is chance


def candidates_picture(document: DiagnosisDocument) -> Picture | None:
    """None where no gain is known."""
    rounds = [one for one in document.get("rounds", []) if _rank(one)][:ROUNDS]
    if not rounds:
        return None
    rows = [len(_rank(one)) for one in rounds]
    kept = any(candidate["kept"] for one in rounds for candidate in one["candidates"])
    with style():
        figure = new_figure(BAR_IN * sum(rows) + ROUND_IN * len(rows) + GAINS_BORDER_IN)
        panels = figure.subplots(
            len(rows), 1, sharex=True, squeeze=False, height_ratios=[n + 0.6 for n in rows]
        )
        for place, (axes, one) in enumerate(zip(panels[:, 0], rounds, strict=True), start=1):
            beside = join_names(one["beside"]) or "the twin as given"
            axes.set_title(f"Round {place}, beside {beside}")
            _draw_gains(axes, _rank(one))
        largest = max(_gain(_rank(one)[0]) for one in rounds)
        # Gains go from tenths to thousands; a plain logarithm has no place for 0.
        axes.set_xscale("symlog", linthresh=LEAST_NATS, linscale=0.3)
        axes.set_xlim(0.0, 6.0 * max(largest, LEAST_NATS))
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:.0f}")
        axes.set_xlabel("gain in log likelihood [nat], logarithmic")
        return Picture(
            svg(figure),
            "Gain of each candidate",
            f"{'Blue: kept in the end' if kept else 'None was kept'}. What gains most alone may only stand in"
            " for what is missing, and be needless beside it; the tables say why each was not kept.",
        )


def _draw_gains(axes: "Axes", candidates: list[CandidateEntry]) -> None:
    gains = [max(_gain(one), 0.0) for one in candidates]
    rows = range(len(gains))
    axes.barh(rows, gains, color=[AFTER if one["kept"] else PLAIN for one in candidates], height=0.7)
    for row, (gain, one) in enumerate(zip(gains, candidates, strict=True)):
        text = nats(one["gain_nats"])
        weight = "bold" if one["kept"] else "normal"
        axes.annotate(
            text,
            (gain, row),
            (4, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
            color=INK,
            weight=weight,
        )
    axes.set_yticks(rows, [one["name"] for one in candidates])
    axes.set_ylim(len(gains) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)


def _rank(search_round: RoundEntry) -> list[CandidateEntry]:
    """Return the largest gains of a round, and the candidates that were kept."""
    known = [one for one in search_round["candidates"] if one["gain_nats"] is not None]
    ranked = sorted(known, key=_gain, reverse=True)
    return [one for place, one in enumerate(ranked) if place < SHOWN or one["kept"]]


def _gain(candidate: CandidateEntry) -> float:
    """Return the gain of a candidate that was fitted [nat]."""
    return candidate["gain_nats"] or 0.0


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


LEAST_ROWS = 3  # of a run that can be drawn
RUNS = 3  # most runs with a picture of their own


def pictures(story: Story) -> Mapping[str, tuple[Picture, ...]] | None:
    """By section of the page; None without matplotlib."""
    if importlib.util.find_spec("matplotlib") is None:
        return None
    story = replace(story, traces=tuple(one for one in story.traces if len(one.time_s) >= LEAST_ROWS))
    adds = is_changed(story.document)
    drawn: dict[str, list[Picture | None]] = {
        "where": [heat_picture(story, adds), heat_course_picture(story), residual_picture(story, adds)],
        "run": [
            *(run_picture(one, _errors(story.document, one), adds) for one in told_runs(story)),
            gap_picture(story.document),
        ],
        "tried": [candidates_picture(story.document)],
        "left": [whiteness_picture(story, adds)],
    }
    return {section: tuple(one for one in found if one is not None) for section, found in drawn.items()}


def told_runs(story: Story) -> list[Trace]:
    """Return the test runs, those with temperatures first. Where no test run
    has any, the worst training run leads.
    """
    tests = sorted(
        (one for one in story.traces if one.role == "test" and one.before is not None),
        key=lambda one: not one.scored,
    )
    others = [one for one in story.traces if one.role != "test" and one.residual("before") is not None]
    worst = sorted(others, key=_error, reverse=True)[:1]
    return [*(worst if not any(one.scored for one in tests) else ()), *tests][:RUNS]


def _error(trace: Trace) -> float:
    residual = trace.residual("before")
    known = residual[np.isfinite(residual)] if residual is not None else np.empty(0)
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0


def _errors(document: DiagnosisDocument, trace: Trace) -> tuple[float | None, float | None]:
    """RMSE before and after, as the diagnosis has them [K]."""
    role: Role = "test" if trace.role == "test" else "train"
    gaps = [document["gap"][when][role] for when in WHENS]
    runs = [gap["per_run"] if gap else {} for gap in gaps]
    before, after = (found[trace.name]["rmse_k"] if trace.name in found else None for found in runs)
    return before, after
