"""Stretches of the history as runs, all of the history as runs for a fit, and runs into the history."""

import json
import sqlite3
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.messages import Event, ReadingQuality, Severity
from edge.formats.run_file import RecordedRun
from edge.formats.run_lines import in_order
from edge.storage.file import connect
from edge.storage.run_rows import (
    BUSY_S,
    NAN,
    TICK_INPUTS,
    RunGrid,
    Tick,
    calibration_events,
    columns_of,
    facts_of,
    known_names,
    reading,
    ticks_between,
)

Floats = NDArray[np.float64]


def run_of_ticks(
    connection: sqlite3.Connection, path: str | Path, ticks: list[Tick], facts: Mapping[str, str]
) -> RecordedRun:
    """Ticks that follow each other as a run; `facts` go before what the history knows. Errors: DataError"""
    columns = columns_of(connection, ticks, RunGrid(path))
    if ticks[0][0] > 0:
        facts = facts_of(connection, ticks[0], ticks[-1]) | dict(facts)
    names = in_order(known_names(columns))
    return RecordedRun({name: np.array(columns[name]) for name in names}, facts, Path(path))


def export_run(
    path: str | Path,
    name: str | None = None,
    first_seq: int | None = None,
    last_seq: int | None = None,
    since_utc: float | None = None,
    until_utc: float | None = None,
) -> RecordedRun:
    """Return a stretch of the history at `path` as a run: a named one, or
    the ticks within all the bounds given.

    Readings that were not good are missing. Inputs are what the board confirmed; what it did not confirm
    counts as off, as in the loop. Time follows the loop's grid, and from session to session the wall clock.
    Errors : DataError
    """
    with reading(path) as connection:
        facts: dict[str, str] = {}
        if name is not None:
            first_seq, last_seq, facts = _find_run(connection, path, name)
        ticks = ticks_between(connection, first_seq, last_seq, since_utc, until_utc)
        if not ticks:
            raise DataError(f"{path}: there are no ticks in this stretch")
        return run_of_ticks(connection, path, ticks, facts)


def newest_utc(path: str | Path) -> float | None:
    """Return when the newest tick was recorded [s since 1970], None where there is none. Errors: DataError"""
    with reading(path) as connection:
        newest = connection.execute("SELECT max(utc) FROM ticks").fetchone()[0]
    return None if newest is None else float(newest)


def events_between(path: str | Path, since_utc: float, until_utc: float) -> list[Event]:
    """Events of the history by their wall clock time, both ends included. Errors: DataError"""
    with reading(path) as connection:
        rows = connection.execute(
            "SELECT key, severity, text, utc FROM events WHERE utc BETWEEN ? AND ? ORDER BY utc, seq, number",
            (since_utc, until_utc),
        ).fetchall()
    return [Event(key, Severity(severity), text, NAN, utc) for key, severity, text, utc in rows]


def name_run(
    path: str | Path, name: str, role: str, first_seq: int, last_seq: int, facts: Mapping[str, str]
) -> None:
    """Call a stretch of recorded ticks a run. Retention keeps its ticks. Errors: DataError"""
    with _writing(path) as connection:
        _insert_run(connection, path, name, role, first_seq, last_seq, facts)


def import_run(path: str | Path, run: RecordedRun, name: str) -> tuple[int, int]:
    """Put a run into the history, a new one if there is none, beside whatever a daemon writes meanwhile.

    Its ticks get negative numbers, which no daemon gives and no subscriber is sent. Returns the first and the
    last one. Errors: DataError
    """
    rows = len(run)
    time_s = run.columns["time_s"]
    start_utc = run.start_utc or 0.0
    step_s = float(np.median(np.diff(time_s))) if rows > 1 else None
    with _writing(path, new=True) as connection:
        # Below every number in use, under the writer's lock: two imports at once get different ones.
        lowest = connection.execute("SELECT min(0, coalesce(min(seq), 0)) FROM ticks").fetchone()[0]
        first, last = lowest - rows, lowest - 1
        seqs = range(first, lowest)
        cells = {
            key: [None if np.isnan(value) else float(value) for value in values]
            for key, values in run.columns.items()
        }
        nothing = [None] * rows
        columns: dict[str, list[Any]] = {
            "seq": list(seqs),
            "utc": [start_utc + t for t in time_s.tolist()],
            "step_s": [step_s] * rows,
            "mode": ["recorded"] * rows,
            "controller": ["recorded"] * rows,
            "reference_c": cells.get("reference_c", nothing),
            "echo_trip_cause": [""] * rows,
            **{f"echo_{key}": cells.get(key, nothing) for key in TICK_INPUTS},
            **{f"sent_{key}": cells.get(key, nothing) for key in TICK_INPUTS},
        }
        from sqlite_utils import Database  # late: see edge/storage/schema.py

        database = Database(connection)
        database.table("ticks").insert_all(
            dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)
        )
        database.table("readings").insert_all(
            {"seq": seq, "signal": key, "value": value, "quality": _quality(value).value}
            for key in run.columns
            if key not in ("time_s", "reference_c", *TICK_INPUTS)
            for seq, value in zip(seqs, cells[key], strict=True)
        )
        _insert_run(connection, path, name, run.facts.get("role", ""), first, last, run.facts)
    return first, last


@contextmanager
def _writing(path: str | Path, new: bool = False) -> Iterator[sqlite3.Connection]:
    """Open a connection in a transaction of its own. Errors: DataError"""
    if not new and not Path(path).exists():
        raise DataError(f"{path}: there is no history")
    try:
        with closing(connect(Path(path), BUSY_S)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            yield connection
            connection.execute("COMMIT")  # closing without it takes everything back
    except (sqlite3.Error, OSError) as error:
        raise DataError(f"{path}: {error}") from error


def _insert_run(
    connection: sqlite3.Connection,
    path: str | Path,
    name: str,
    role: str,
    first_seq: int,
    last_seq: int,
    facts: Mapping[str, str],
) -> None:
    if connection.execute("SELECT 1 FROM runs WHERE name = ?", (name,)).fetchone():
        raise DataError(f"{path}: there is a run {name!r} already")
    if not first_seq <= last_seq:
        raise DataError(f"{path}: {name!r} would end at tick {last_seq}, before its start at {first_seq}")
    connection.execute(
        "INSERT INTO runs (name, role, first_seq, last_seq, facts) VALUES (?, ?, ?, ?, ?)",
        (name, role, first_seq, last_seq, json.dumps(dict(facts), ensure_ascii=False)),
    )


def _find_run(connection: sqlite3.Connection, path: str | Path, name: str) -> tuple[int, int, dict[str, str]]:
    row = connection.execute("SELECT first_seq, last_seq, facts FROM runs WHERE name = ?", (name,)).fetchone()
    if row is None:
        known = [other for (other,) in connection.execute("SELECT name FROM runs ORDER BY name LIMIT 20")]
        raise DataError(f"{path}: there is no run {name!r}; known are {known}")
    return row[0], row[1], json.loads(row[2])


def _quality(value: float | None) -> ReadingQuality:
    return ReadingQuality.ABSENT if value is None else ReadingQuality.GOOD


def export_stretches(
    path: str | Path, since_utc: float | None = None, until_utc: float | None = None
) -> list[RecordedRun]:
    """Return the rig's recordings between two times, in their order, without imported runs.

    From session to session only the wall clock could tell how much time passed, so none crosses one; nor a
    new calibration of a sensor, whose jump is not heat. Ticks of a named run of role test are stretches of
    their own and carry that role. Inputs are as `export_run`'s: what the board confirmed, so what was sent
    after safety and not what was wanted.

    Errors : DataError
    """
    with reading(path) as connection:
        ticks = ticks_between(connection, None, None, since_utc, until_utc)
        if not ticks:
            raise DataError(f"{path}: there are no ticks in this stretch")
        tests = connection.execute(
            "SELECT first_seq, last_seq FROM runs WHERE lower(trim(role)) = 'test' ORDER BY first_seq"
        ).fetchall()
        calibrated = [seq for seq, _ in calibration_events(connection, ticks[0][0], ticks[-1][0])]

        def kind(tick: Tick) -> tuple[object, int, tuple[int, int] | None]:
            test = next((run for run in tests if run[0] <= tick[0] <= run[1]), None)
            return tick[1], bisect_right(calibrated, tick[0]), test

        return [
            run_of_ticks(connection, path, list(rows), {"role": "test"} if test else {})
            for (*_, test), rows in groupby(ticks, kind)
        ]
