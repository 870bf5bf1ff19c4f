"""A diagnosis in some fifteen lines, for the terminal."""

import shlex
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from edge.diagnosis.diagnosis_document import WHENS, DiagnosisDocument
from edge.diagnosis.report.number_text import clock, kelvin, percent, probability
from edge.diagnosis.report.wording import (
    ROLES,
    beaten,
    best_simple,
    cautions,
    headline,
    heat_text,
    is_changed,
    join_names,
    meaning,
    new_twin,
    parameter_text,
    rmse_k,
    scored_role,
    shrink,
    step_error,
    step_names,
)

COLUMNS = 100  # of a line
REGIMES = 2
MOST_EVENTS = 8


def summary_text(document: DiagnosisDocument, folder: str = "report", page: str | None = None) -> str:
    """Return the facts of the report, in its order.

    folder : of the report, for what lies there;  page : its page there, None where none was written
    """
    lines = [*_lines(document, folder), *([] if page is None else [f"Report: {Path(folder) / page}"])]
    return "\n".join(lines) + "\n"


def _lines(document: DiagnosisDocument, folder: str) -> Iterator[str]:
    yield from _wrap(headline(document), "", "  ")
    for sentence in meaning(document):
        yield from _wrap(sentence)
    yield from _regimes(document)
    yield from _effects(document)
    yield from _doubtful(document)
    yield from _events(document)
    yield from _gap_rows(document)
    for sentence in (*cautions(document), *beaten(document)):
        yield from _wrap(sentence)
    if experiment := document["next_experiment"]:
        yield from _experiment(experiment, folder)
    if new_twin(document):
        yield f"To adopt the new twin: greenhouse twin adopt {shlex.quote(folder)}"
    for reason in document.get("against_adopting", ()) if is_changed(document) else ():
        yield from _wrap(f"Not to be adopted: {reason}", "")


def _regimes(document: DiagnosisDocument) -> Iterator[str]:
    if document["regimes"]:
        yield "Where it disagrees, by share of the squared error:"
    for regime in document["regimes"][:REGIMES]:
        share = percent(regime["share_of_squared_error"])
        yield from _wrap(f"{regime['where']}; there {heat_text(regime)}", f"  {share:>6}  ", " " * 10)


def _effects(document: DiagnosisDocument) -> Iterator[str]:
    """Yield the missing effects, their probabilities and their rivals."""
    if document["effects"]:
        yield "What is missing, by how much, and how sure:"
    for effect in document["effects"]:
        told = [parameter_text(name, value) for name, value in effect["parameters"].items()]
        told += [f"probability {probability(effect.get('probability'))}"]
        if effect["alternatives"]:
            told += [f"these data cannot tell it from {join_names(effect['alternatives'])}"]
        equation = effect.get("equation", "").rstrip(".")
        yield from _wrap(f"{effect['name']}: {equation}".rstrip(": "))
        yield from _wrap("; ".join(told), "    ", "    ")


def _doubtful(document: DiagnosisDocument) -> Iterator[str]:
    if document.get("doubtful"):
        yield "What explains these runs too, and does not stand:"
    for item in document.get("doubtful", ()):
        yield from _wrap(f"{item['name']}: {'; '.join(item['against'])}")


def _events(document: DiagnosisDocument) -> Iterator[str]:
    """Yield when doors were open, run by run."""
    events = document.get("events", ())
    by_run: dict[str, list[str]] = {}
    for event in events[:MOST_EVENTS]:
        text = f"{clock(event['from_s'])} to {clock(event['to_s'])}"
        by_run.setdefault(event["run"], []).append(text)
    told = [f"{run} {', '.join(times)}" for run, times in by_run.items()]
    told += [f"{len(events) - MOST_EVENTS} more"] if len(events) > MOST_EVENTS else []
    if told:
        yield from _wrap(f"A door or lid was open, found and not recorded: {'; '.join(told)}", "", "  ")


def _gap_rows(document: DiagnosisDocument) -> Iterator[str]:
    gap = document["gap"]
    heads = "".join(f"{head:>9}" for head in ("before", "after", "noise", "closed"))
    yield f"{'RMSE of free runs [K]':<24}{heads}  best simple model"
    for role, name in ROLES.items():
        errors = [rmse_k(document, when, role) for when in WHENS]
        closed = shrink(document, role) if is_changed(document) else None
        cells = [*map(kelvin, (*errors, gap["noise_floor"][role])), percent(closed)]
        simple = best_simple(document, "test_k") if role == "test" else ""
        yield (f"  {name:<22}" + "".join(f"{cell:>9}" for cell in cells) + f"  {simple}").rstrip()
    if known := document.get("left_out"):
        cells = [*map(kelvin, (known["given_k"], known["after_k"])), "", ""]
        simple = best_simple(document, "simple_k")
        yield (
            f"  {'rows left out of fits':<22}" + "".join(f"{cell:>9}" for cell in cells) + f"  {simple}"
        ).rstrip()
    steps = document.get("waterfall", [])
    if len(steps) > 2:
        role = scored_role(document)
        told = zip(step_names(steps), (step_error(step, role) for step in steps), strict=True)
        steps_text = ", ".join(f"{name} {kelvin(value)}" for name, value in told)
        yield from _wrap(f"Step by step, {ROLES[role]}: {steps_text}")


def _experiment(experiment: Mapping[str, Any], folder: str) -> Iterator[str]:
    worded = {key: experiment[key] for key in ("why", "profile") if isinstance(experiment.get(key), str)}
    yield "Next experiment:"
    yield from _wrap(worded.get("why") or ", ".join(f"{key} {value}" for key, value in experiment.items()))
    if "profile" in worded:
        profile = shlex.quote(str(Path(folder) / worded["profile"]))
        yield f"  greenhouse experiment {profile} --out next_run.csv"


def _wrap(text: str, first: str = "  ", further: str = "    ") -> list[str]:
    """Lines of a sentence; a command is never broken this way. first, further : what lines begin with"""
    return textwrap.wrap(
        text,
        COLUMNS,
        initial_indent=first,
        subsequent_indent=further,
        break_long_words=False,
        break_on_hyphens=False,
    )
