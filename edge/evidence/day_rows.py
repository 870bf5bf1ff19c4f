"""One day of the history as lines of JSON: facts, marks, sessions, gaps and every tick, and back.

A tick is what telemetry sends of it: readings, decision, command, safety's changes, echo, events, forecasts.
"""

import gzip
import io
import json
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

from edge.core.errors import DataError
from edge.core.messages import Severity
from edge.evidence.marks import EvidenceMark
from edge.formats.cross_check import Rule
from edge.formats.reader import Foreign, parse_json, read
from edge.formats.tick_json import json_value, tick_json
from edge.storage.tick_rows import read_ticks

CHUNK_TICKS = 200
LINE_BYTES_MAX = 1 << 20
ROWS_BYTES_MAX = 512 << 20  # unpacked; a day of 1 s steps has half of it


@dataclass(frozen=True, slots=True)
class SealedReading(Foreign):
    """A reading of a tick."""

    value: float | None
    quality: str


@dataclass(frozen=True, slots=True)
class SealedEvent(Foreign):
    """An event of a tick."""

    key: str
    severity: Severity
    text: str
    utc: float | None


@dataclass(frozen=True, slots=True)
class SealedEcho(Foreign):
    """The board's confirmed outputs."""

    heater_duty: float | None


@dataclass(frozen=True, slots=True)
class SealedForecast(Foreign):
    """A predictor's forecast. temp_c : by minutes ahead"""

    temp_c: Mapping[str, float | None]


@dataclass(frozen=True, slots=True)
class SealedTick(Foreign):
    """The part of a tick that a report is made of."""

    seq: Annotated[int, Rule(low=1)]
    utc: float
    step_s: Annotated[float, Rule(above=0.0)]
    mode: str
    readings: Mapping[str, SealedReading]
    reference_c: float | None
    forecasts: Mapping[str, SealedForecast]
    echo: SealedEcho | None
    events: tuple[SealedEvent, ...]
    ticks_skipped: Annotated[int, Rule(low=0)]


@dataclass(frozen=True, slots=True)
class SealedRow:
    """A line: one of its keys is set."""

    facts: Mapping[str, Any] | None = None
    mark: EvidenceMark | None = None
    session: Mapping[str, Any] | None = None
    gap: Mapping[str, Any] | None = None
    tick: SealedTick | None = None


@dataclass(frozen=True, slots=True)
class SeqGap:
    """Tick numbers of a day that have no row. reason : as the history says, "" where it does not"""

    first_seq: Annotated[int, Rule(low=1)]
    last_seq: Annotated[int, Rule(low=1)]
    reason: Annotated[str, Rule(most=400)]


@dataclass(slots=True)
class DayRows:
    """The packed lines of a day, and what its entry says of them."""

    packed: bytes = b""
    ticks: int = 0
    last_seq: int = 0
    gaps: tuple[SeqGap, ...] = ()
    seqs: list[int] = field(default_factory=list)


def collect_day(
    connection: sqlite3.Connection,
    after_seq: int,
    end_utc: float,
    facts: Mapping[str, Any],
    marks: Iterable[EvidenceMark],
) -> DayRows:
    """Return the ticks after `after_seq` up to the last one before `end_utc`.

    Ticks between these two belong to the day whatever their own time: each tick is sealed once.
    """
    newest = connection.execute(
        "SELECT max(seq) FROM ticks WHERE seq > ? AND utc < ?", (after_seq, end_utc)
    ).fetchone()[0]
    day = DayRows(last_seq=newest or after_seq)
    bounds = (after_seq + 1, day.last_seq)
    stored = connection.execute("SELECT seq FROM ticks WHERE seq BETWEEN ? AND ? ORDER BY seq", bounds)
    reasons = connection.execute(
        "SELECT first_seq, last_seq, utc, reason FROM gaps WHERE last_seq >= ? AND first_seq <= ? ORDER BY 1",
        bounds,
    ).fetchall()
    out = io.BytesIO()
    with gzip.GzipFile(fileobj=out, mode="wb", mtime=0) as file:

        def write(kind: str, value: Any) -> None:
            line = json.dumps({kind: value}, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
            file.write(line.encode() + b"\n")

        write("facts", json_value(facts))
        for mark in marks:
            write("mark", asdict(mark))
        for session in _sessions(connection, *bounds):
            write("session", session)
        for first, last, utc, reason in reasons:
            write("gap", {"first_seq": first, "last_seq": last, "utc": utc, "reason": reason})
        for chunk in _chunks([seq for (seq,) in stored]):
            for seq, record in sorted(read_ticks(connection, chunk).items()):
                write("tick", tick_json(record))
                day.seqs.append(seq)
    day.packed, day.ticks = out.getvalue(), len(day.seqs)
    day.gaps = tuple(
        SeqGap(first, last, _reason(reasons, first, last))
        for first, last in missing_numbers(day.seqs, after_seq, day.last_seq)
    )
    return day


def missing_numbers(seqs: Iterable[int], after_seq: int, last_seq: int) -> list[tuple[int, int]]:
    """Return the ranges within after_seq + 1 ... last_seq that ascending `seqs` leave out."""
    found, before = [], after_seq
    for seq in (*seqs, last_seq + 1):
        if seq > before + 1:
            found.append((before + 1, seq - 1))
        before = seq
    return found


def read_rows(packed: bytes, place: str) -> Iterator[SealedRow]:
    """Yield the lines of a day. Errors: DataError, which names the line"""
    total = 0
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(packed)) as file:
            for number in range(1, ROWS_BYTES_MAX):
                line = file.readline(LINE_BYTES_MAX + 1)
                total += len(line)
                where = f"{place}: line {number}"
                if not line:
                    return
                if not line.endswith(b"\n") or total > ROWS_BYTES_MAX:
                    raise DataError(f"{where}: longer than a line, or a day, may be")
                yield read(SealedRow, parse_json(line, where), where)
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(f"{place}: not a packed day, or damaged: {error}") from error


def _sessions(connection: sqlite3.Connection, first_seq: int, last_seq: int) -> Iterator[dict[str, Any]]:
    """Yield the daemon's starts that these ticks belong to."""
    rows = connection.execute(
        "SELECT session, first_seq, started_utc, ended_utc, software_version, config_sha256, models, boot_id"
        " FROM sessions WHERE session IN (SELECT DISTINCT session FROM ticks WHERE seq BETWEEN ? AND ?)",
        (first_seq, last_seq),
    )
    names = [column[0] for column in rows.description]
    for row in rows:
        yield dict(zip(names, row, strict=True))


def _reason(reasons: list[tuple[int, int, float, str]], first: int, last: int) -> str:
    """Return why a range is missing; a part without a reason leaves the whole without one."""
    here = [row for row in reasons if row[0] <= last and row[1] >= first]
    covered = first
    for low, high, _, _ in here:
        if low <= covered:
            covered = max(covered, high + 1)
    return "; ".join(dict.fromkeys(row[3] for row in here))[:400] if covered > last else ""


def _chunks(seqs: list[int]) -> Iterator[list[int]]:
    for start in range(0, len(seqs), CHUNK_TICKS):
        yield seqs[start : start + CHUNK_TICKS]
