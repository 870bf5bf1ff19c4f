"""A diagnosis in some fifteen lines, for the terminal."""

import shlex
import textwrap
from collections.abc import Iterator
from pathlib import Path

from edge.diagnosis.diagnosis_document import DiagnosisDocument
from edge.diagnosis.report.wording import (
    GAP_HEADS,
    WHERE_HEAD,
    against_adopting,
    beaten,
    cautions,
    doors,
    doubtful,
    effect_lines,
    experiment_lines,
    gap_rows,
    headline,
    meaning,
    new_twin,
    steps_text,
    where,
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
    yield from _effects(document)
    for sentence in doubtful(document):
        yield from _wrap(sentence, "", "  ")
    if found := where(document):
        yield WHERE_HEAD
        for sentence in found[:REGIMES]:
            yield from _wrap(sentence)
    yield from _wrap(doors(document, MOST_EVENTS), "", "  ")
    yield from _gap(document)
    for sentence in (*cautions(document), *beaten(document)):
        yield from _wrap(sentence)
    for reason in against_adopting(document):
        yield from _wrap(reason, "", "  ")
    if new_twin(document):
        yield f"To adopt the new twin: greenhouse twin adopt {shlex.quote(folder)}"
    if experiment := document["next_experiment"]:
        told, command = experiment_lines(experiment, folder)
        yield "Next experiment:"
        yield from _wrap(" ".join(told))
        if command:
            yield f"  {command}"


def _effects(document: DiagnosisDocument) -> Iterator[str]:
    """Yield the missing effects, their probabilities and their rivals."""
    if document["effects"]:
        yield "What is missing, by how much, and how sure:"
    for effect in document["effects"]:
        _, equation, evidence = effect_lines(effect)  # the headline has the name in words
        yield from _wrap(f"{effect['name']}: {'; '.join(filter(None, [equation, *evidence]))}")


def _gap(document: DiagnosisDocument) -> Iterator[str]:
    *heads, last = GAP_HEADS
    yield f"{'RMSE of free runs [K]':<24}{''.join(f'{head:>9}' for head in heads)}  {last}"
    for name, *cells, simple in gap_rows(document):
        yield f"  {name:<22}{''.join(f'{cell:>9}' for cell in cells)}  {simple}".rstrip()
    if len(document.get("waterfall", [])) > 2:
        yield from _wrap(f"Step by step, {steps_text(document)}")


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
