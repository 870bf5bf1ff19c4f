"""Rows of the history as columns of a run, a piece at a time and without numpy.

`greenhouse export` and the export of the page share what stands here.
"""

import sqlite3
from array import array
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from edge.core.errors import DataError
from edge.core.plain_text import plain
from edge.formats.owner import open_database
from edge.formats.run_lines import absences, check_facts, head_text, in_order, rows_text
from edge.storage.schema_version import SCHEMA_VERSION, USABLE_VERSION

TICK_INPUTS = ("heater_duty", "fan_on", "led")  # columns of a run that the history keeps in `ticks`
ALWAYS = "temp_air_c"  # a column of every run, also where no reading was good
ROWS_AT_ONCE = 1000  # in one transaction: a long one would keep the daemon's log from being cut
BUSY_S = 10.0
NAN = float("nan")
Tick = tuple[Any, ...]  # a row of `ticks_between`
Columns = dict[str, "array[float]"]  # NaN where nothing is known
Opened = Callable[[], AbstractContextManager[sqlite3.Connection]]


def ticks_between(
    connection: sqlite3.Connection,
    first_seq: int | None,
    last_seq: int | None,
    since_utc: float | None,
    until_utc: float | None,
    most: int = -1,
) -> list[Tick]:
    """Return ticks within all the bounds given, in their order; without a first number those of this rig.

    most : ticks to return, the first ones; -1 for all
    """
    # With a unary plus the planner finds the few rows by their times instead of walking all numbers.
    plus = "+" if last_seq is None and (since_utc is not None or until_utc is not None) else ""
    first_seq = 1 if first_seq is None else first_seq
    bounds = {"seq >=": first_seq, "seq <=": last_seq, "utc >=": since_utc, "utc <=": until_utc}
    given = {bound: value for bound, value in bounds.items() if value is not None}
    return connection.execute(
        "SELECT seq, session, utc, step_s, ticks_skipped, reference_c, echo_trip_cause IS NULL,"
        " echo_heater_duty, echo_fan_on, echo_led FROM ticks"
        f" WHERE {' AND '.join(f'{bound} ?' for bound in given).replace('seq', plus + 'seq')}"
        f" ORDER BY {plus}seq LIMIT ?",
        (*given.values(), most),
    ).fetchall()


class RunGrid:
    """Seconds since a run's first tick, piece by piece. path : of the history, for errors"""

    def __init__(self, path: str | Path) -> None:
        self._path = path
        self._before: Tick | None = None
        self._time_s = 0.0

    def times(self, ticks: list[Tick]) -> "array[float]":
        """Return the times of the next ticks [s]. Errors: DataError where the wall clock went back"""
        found = array("d")
        for tick in ticks:
            self._time_s += 0.0 if self._before is None else self._step(self._before, tick)
            self._before = tick
            found.append(round(self._time_s, 3))
        return found

    def _step(self, before: Tick, tick: Tick) -> float:
        (seq_before, session_before, utc_before), (seq, session, utc, step_s, skipped) = before[:3], tick[:5]
        same_grid = session is not None and session == session_before
        step = step_s * (seq - seq_before + skipped) if same_grid else utc - utc_before
        if not step > 0.0:
            raise DataError(
                f"{self._path}: tick {seq}: the wall clock went back; export what is on one side of it"
            )
        return float(step)


def columns_of(connection: sqlite3.Connection, ticks: list[Tick], grid: RunGrid) -> Columns:
    """Return the columns of ticks that follow each other. Errors: DataError"""
    return {"time_s": grid.times(ticks), **_readings(connection, ticks), **_inputs(ticks)}


def known_names(columns: Columns) -> set[str]:
    """Return the columns that a run has: those with a value, and the air."""
    return {
        name for name, values in columns.items() if name == ALWAYS or any(value == value for value in values)
    }


def facts_of(connection: sqlite3.Connection, first: Tick, last: Tick) -> dict[str, str]:
    """Return the facts of a stretch of this rig's ticks; a sensor that was calibrated within it is one."""
    calibrated = calibration_events(connection, first[0] + 1, last[0])
    controllers = connection.execute(
        "SELECT DISTINCT controller FROM ticks WHERE seq BETWEEN ? AND ? ORDER BY 1", (first[0], last[0])
    )
    return {
        "start_utc": datetime.fromtimestamp(first[2], UTC).isoformat(timespec="milliseconds"),
        "history_id": connection.execute("SELECT id FROM history").fetchone()[0],
        "first_seq": str(first[0]),
        "last_seq": str(last[0]),
        "controllers": ", ".join(name for (name,) in controllers),
    } | ({"calibrations": "; ".join(f"tick {seq}: {text}" for seq, text in calibrated)} if calibrated else {})


def calibration_events(
    connection: sqlite3.Connection, first_seq: int, last_seq: int
) -> list[tuple[int, str]]:
    """Return the first tick by each other calibration of a sensor, and the event's text."""
    return connection.execute(
        "SELECT seq, text FROM events WHERE key = 'calibration.changed' AND seq BETWEEN ? AND ? ORDER BY seq",
        (first_seq, last_seq),
    ).fetchall()


def run_text(path: Path, since_utc: float, until_utc: float, opened: Opened) -> Iterator[str]:
    """Yield the run file of a stretch of the history in pieces, as `greenhouse export` writes it.

    All ticks are looked through before the first piece, so a stretch that can't be exported is refused then.
    No transaction is open while a piece is on its way: who reads slowly holds up nobody.
    Errors : DataError
    """
    names, first, last = {"time_s"}, None, None
    for columns, ticks in _pieces(path, None, since_utc, until_utc, opened):
        names |= known_names(columns)
        first, last = first or ticks[0], ticks[-1]
    if first is None or last is None:
        raise DataError(f"{path}: there are no ticks in this stretch")
    with opened() as connection:
        facts = facts_of(connection, first, last) | absences(names)
    check_facts(path, facts)
    ordered = in_order(names)
    yield head_text(ordered, facts)
    for columns, ticks in _pieces(path, last[0], since_utc, until_utc, opened):
        yield rows_text(columns.get(name, array("d", [NAN]) * len(ticks)) for name in ordered)


def _pieces(
    path: Path, last_seq: int | None, since_utc: float, until_utc: float, opened: Opened
) -> Iterator[tuple[Columns, list[Tick]]]:
    """Yield columns and ticks of a stretch, each piece by a connection of its own."""
    grid = RunGrid(path)
    with opened() as connection:
        bounds = connection.execute(
            "SELECT min(seq), max(seq) FROM ticks WHERE +seq > 0 AND utc >= ? AND utc <= ?",
            (since_utc, until_utc),
        ).fetchone()
    next_seq, newest = bounds
    if next_seq is None:
        return
    last_seq = newest if last_seq is None else last_seq
    while True:
        with opened() as connection:
            ticks = ticks_between(connection, next_seq, last_seq, since_utc, until_utc, ROWS_AT_ONCE)
            if not ticks:
                return
            columns = columns_of(connection, ticks, grid)
        yield columns, ticks
        next_seq = ticks[-1][0] + 1


@contextmanager
def reading(path: str | Path, busy_s: float = BUSY_S, how: str = "mode=ro") -> Iterator[sqlite3.Connection]:
    """Open a read-only connection. how : parameters of SQLite's URI. Errors: DataError"""
    try:
        with closing(open_database(path, how, timeout=busy_s)) as connection:
            connection.text_factory = _text
            version = connection.execute("PRAGMA user_version").fetchone()[0]
            if not USABLE_VERSION <= version <= SCHEMA_VERSION:
                raise DataError(
                    f"{path}: its version is {version}, not {SCHEMA_VERSION}: let the daemon open it once"
                )
            # A view in a table's place is refused: its query may have no end.
            for (name,) in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'view'"):
                if not name.startswith("v_"):
                    raise DataError(f"{path}: {plain(name)} is a view, and no view of a history is called so")
            yield connection
    except (sqlite3.Error, UnicodeDecodeError) as error:  # SQLite's words may repeat damaged bytes
        raise DataError(f"{path}: {error}") from error


def _text(stored: bytes) -> str:
    """Return a stored text; a damaged letter does not end the command that reads it."""
    return stored.decode(errors="replace")


def _readings(connection: sqlite3.Connection, ticks: list[Tick]) -> Columns:
    row_of = {tick[0]: row for row, tick in enumerate(ticks)}
    nothing = array("d", [NAN]) * len(ticks)
    columns: Columns = {ALWAYS: nothing[:]}
    stored = connection.execute(
        "SELECT seq, signal, value FROM readings WHERE seq BETWEEN ? AND ? AND quality = 'good'",
        (ticks[0][0], ticks[-1][0]),
    )
    for seq, signal, value in stored:
        if seq in row_of and value is not None:
            columns.setdefault(signal, nothing[:])[row_of[seq]] = value
    return columns


def _inputs(ticks: list[Tick]) -> Columns:
    """Return the driven inputs, 0 where the board did not confirm, NaN where an imported run is silent; the
    target.
    """
    driven = {
        name: array("d", (0.0 if tick[6] else _or_nan(tick[7 + k]) for tick in ticks))
        for k, name in enumerate(TICK_INPUTS)
    }
    return {**driven, "reference_c": array("d", (_or_nan(tick[5]) for tick in ticks))}


def _or_nan(value: float | None) -> float:
    return NAN if value is None else value
