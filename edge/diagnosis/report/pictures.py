"""Which pictures a report has, and where on the page."""

import importlib.util
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from edge.diagnosis.diagnosis_document import WHENS, DiagnosisDocument, Role
from edge.diagnosis.report.candidates_picture import candidates_picture
from edge.diagnosis.report.gap_picture import gap_picture
from edge.diagnosis.report.heat_picture import heat_picture
from edge.diagnosis.report.picture import Picture
from edge.diagnosis.report.residual_picture import heat_course_picture, residual_picture
from edge.diagnosis.report.run_picture import run_picture
from edge.diagnosis.report.story import Story, Trace
from edge.diagnosis.report.whiteness_picture import whiteness_picture
from edge.diagnosis.report.wording import is_changed

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
