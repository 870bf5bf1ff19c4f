"""Marks: a person's notes of what is being done to the rig, written when it is done and sealed that night."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from edge.core.errors import DataError, RequestError
from edge.evidence.protocol import PHASES
from edge.formats.atomic_file import write_atomically
from edge.formats.cross_check import Rule
from edge.formats.reader import parse_json, read, read_bytes

MARKS = "marks.jsonl"
BEGIN, END = "begin", "end"


@dataclass(frozen=True, slots=True)
class EvidenceMark:
    """One mark. utc : [s since 1970]; what : a phase of the protocol"""

    utc: Annotated[float, Rule(low=0.0)]
    what: Annotated[str, Rule(choices=PHASES)]
    edge: Annotated[str, Rule(choices=(BEGIN, END))]
    text: Annotated[str, Rule(most=200)] = ""


@dataclass(frozen=True, slots=True)
class MarkedSpan:
    """A phase from its begin to its end, the end of the record where it was left open [s since 1970]."""

    what: str
    begin_utc: float
    end_utc: float


def read_marks(folder: Path) -> list[EvidenceMark]:
    """Return all marks, sealed or not, in their order. Errors: DataError, which names the line"""
    path = folder / MARKS
    if not path.exists():
        return []
    lines = read_bytes(path).decode(errors="replace").splitlines()
    return [
        read(EvidenceMark, parse_json(line, place), place)
        for line, place in ((line, f"{path}: line {number}") for number, line in enumerate(lines, 1))
    ]


def add_mark(folder: Path, mark: EvidenceMark) -> None:
    """Append a mark. Errors: RequestError for one that contradicts those before; DataError, OSError"""
    marks = read_marks(folder)
    is_open = mark.what in open_phases(marks)
    if is_open == (mark.edge == BEGIN):
        raise RequestError(f"{mark.what} {'has begun already' if is_open else 'has not begun'}")
    if marks and mark.utc < marks[-1].utc:
        raise RequestError("the clock is before the last mark: is it right?")
    text = "".join(json.dumps(asdict(one)) + "\n" for one in (*marks, mark))
    write_atomically(folder / MARKS, text)


def open_phases(marks: list[EvidenceMark]) -> list[str]:
    """Return the phases that have begun and not ended."""
    last = {mark.what: mark.edge for mark in marks}
    return [what for what, edge in last.items() if edge == BEGIN]


def spans(marks: list[EvidenceMark], end_utc: float) -> list[MarkedSpan]:
    """Return the marked spans in the order of their begins. Errors: DataError for an end without a begin"""
    begun: dict[str, float] = {}
    found = []
    for mark in marks:
        if mark.edge == BEGIN:
            begun.setdefault(mark.what, mark.utc)
        elif mark.what in begun:
            found.append(MarkedSpan(mark.what, begun.pop(mark.what), mark.utc))
        else:
            raise DataError(f"mark {mark.what} at {mark.utc:.0f} ends without a begin")
    found += [MarkedSpan(what, begin_utc, end_utc) for what, begin_utc in begun.items()]
    return sorted(found, key=lambda span: span.begin_utc)
