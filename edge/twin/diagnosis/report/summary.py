"""A diagnosis in some fifteen lines, for the terminal."""

import shlex
from collections.abc import Iterator
from typing import Any

from edge.twin.diagnosis.report.number_text import duration, kelvin, nats, odds, percent, plus_minus
from edge.twin.diagnosis.report.wording import (
    Document,
    gap_sentence,
    headline,
    meaning,
    new_twin,
    shrink,
    step_names,
    white_runs,
)

REGIMES = 3


def summary_text(document: Document, folder: str = "report") -> str:
    """The facts of the report. folder : of the report, for the command that adopts the new twin"""
    return "\n".join(_lines(document, folder)) + "\n"


def _lines(document: Document, folder: str) -> Iterator[str]:
    yield headline(document)
    yield from (f"  {sentence}" for sentence in meaning(document))
    yield gap_sentence(document)
    yield from _gap_rows(document)
    yield from _regimes(document)
    yield from _sure(document)
    if experiment := document["next_experiment"]:
        yield f"Next experiment: {_experiment(experiment)}"
    if new_twin(document):
        yield f"To adopt the new twin: greenhouse twin adopt {shlex.quote(folder)}"
    yield f"Took {duration(document['seconds'])}."


def _gap_rows(document: Document) -> Iterator[str]:
    gap = document["gap"]
    yield f"  {'RMSE of free runs [K]':<24}{'before':>9}{'after':>9}{'noise':>9}{'closed':>9}"
    for role in ("train", "test"):
        errors = [(gap[when][role] or {}).get("rmse_k") for when in ("before", "after")]
        cells = [*map(kelvin, (*errors, gap["noise_floor"][role])), percent(shrink(document, role))]
        yield f"  {role:<24}" + "".join(f"{cell:>9}" for cell in cells)
    steps = document.get("waterfall", [])
    if len(steps) > 2:
        told = zip(step_names(steps), steps, strict=True)
        yield "  Step by step: " + ", ".join(f"{name} {kelvin(step['train_rmse_k'])}" for name, step in told)


def _regimes(document: Document) -> Iterator[str]:
    if document["regimes"]:
        yield "Where it disagrees:"
    for regime in document["regimes"][:REGIMES]:
        share, heat = regime["share_of_squared_error"], plus_minus(regime["heat_w"], regime["heat_w_se"])
        yield f"  {percent(share):>5} of the squared error: {regime['where']}; {heat} W"


def _sure(document: Document) -> Iterator[str]:
    for effect in document["effects"]:
        bounds = "".join(f"; {name} is at its bound" for name in effect.get("at_bound", ()))
        log_odds = effect["log_odds"]
        yield f"How sure: {effect['name']} has log odds {nats(log_odds)} ({odds(log_odds)}){bounds}"
    (before, tested), (after, tested_after) = (white_runs(document, when) for when in ("before", "after"))
    if tested and tested_after:
        yield f"White innovations: {before} of {tested} runs before, {after} of {tested_after} after"


def _experiment(experiment: dict[str, Any]) -> str:
    parts = [str(experiment[key]) for key in ("why", "profile") if isinstance(experiment.get(key), str)] or [
        ", ".join(f"{key} {value}" for key, value in experiment.items())
    ]
    return "; ".join(parts)
