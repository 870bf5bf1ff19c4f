"""Ticks of the history as the columns of a run."""

import sqlite3
from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun

TICK_INPUTS = ("heater_duty", "fan_on", "led")  # columns of a run that the history keeps in `ticks`
NAN = float("nan")
Floats = NDArray[np.float64]
Tick = tuple[Any, ...]  # a row of `ticks_between`


def ticks_between(
    connection: sqlite3.Connection,
    first_seq: int | None,
    last_seq: int | None,
    since_utc: float | None,
    until_utc: float | None,
) -> list[Tick]:
    """Ticks within all the bounds given, in their order; without a first number those of this rig alone."""
    first_seq = 1 if first_seq is None else first_seq
    bounds = {"seq >=": first_seq, "seq <=": last_seq, "utc >=": since_utc, "utc <=": until_utc}
    given = {bound: value for bound, value in bounds.items() if value is not None}
    # With a unary plus the planner finds the few rows by their times instead of walking all numbers.
    plus = "" if since_utc is None and until_utc is None else "+"
    return connection.execute(
        "SELECT seq, session, utc, step_s, ticks_skipped, reference_c, echo_trip_cause IS NULL,"
        " echo_heater_duty, echo_fan_on, echo_led FROM ticks"
        f" WHERE {' AND '.join(f'{bound} ?' for bound in given).replace('seq', plus + 'seq')}"
        f" ORDER BY {plus}seq",
        tuple(given.values()),
    ).fetchall()


def run_of_ticks(
    connection: sqlite3.Connection, path: str | Path, ticks: list[Tick], facts: Mapping[str, str]
) -> RecordedRun:
    """Ticks that follow each other as a run; `facts` go before what the history knows. Errors: DataError"""
    seqs = [tick[0] for tick in ticks]
    columns = {"time_s": _times(path, ticks), **_readings(connection, seqs), **_inputs(ticks)}
    if seqs[0] > 0:
        facts = _facts_of(connection, ticks) | dict(facts)
    first = ("time_s", "temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")
    known = {
        key: values for key, values in columns.items() if key == "temp_air_c" or not np.isnan(values).all()
    }
    ordered = sorted(known, key=lambda key: (first.index(key) if key in first else len(first), key))
    return RecordedRun({key: known[key] for key in ordered}, facts, Path(path))


def _times(path: str | Path, ticks: list[Tick]) -> Floats:
    """Seconds since the first tick."""
    times = [0.0]
    for before, tick in pairwise(ticks):
        (seq_before, session_before, utc_before), (seq, session, utc, step_s, skipped) = before[:3], tick[:5]
        same_grid = session is not None and session == session_before
        step = step_s * (seq - seq_before + skipped) if same_grid else utc - utc_before
        if not step > 0.0:
            raise DataError(f"{path}: tick {seq}: the wall clock went back; export what is on one side of it")
        times.append(times[-1] + step)
    return np.round(times, 3)


def _readings(connection: sqlite3.Connection, seqs: list[int]) -> dict[str, Floats]:
    row_of = {seq: row for row, seq in enumerate(seqs)}
    columns: dict[str, Floats] = {"temp_air_c": np.full(len(seqs), NAN)}
    stored = connection.execute(
        "SELECT seq, signal, value FROM readings WHERE seq BETWEEN ? AND ? AND quality = 'good'",
        (seqs[0], seqs[-1]),
    )
    for seq, signal, value in stored:
        if seq in row_of:
            columns.setdefault(signal, np.full(len(seqs), NAN))[row_of[seq]] = value
    return columns


def _inputs(ticks: list[Tick]) -> dict[str, Floats]:
    """Return the driven inputs, 0 where the board did not confirm, NaN where
    an imported run is silent; the target.
    """
    table = np.array([[*tick[7:10], tick[5]] for tick in ticks], dtype=np.float64)
    unconfirmed = np.array([tick[6] for tick in ticks], dtype=bool)
    table[unconfirmed, :3] = 0.0
    return dict(zip((*TICK_INPUTS, "reference_c"), table.T, strict=True))


def _facts_of(connection: sqlite3.Connection, ticks: list[Tick]) -> dict[str, str]:
    first_seq, last_seq = ticks[0][0], ticks[-1][0]
    controllers = connection.execute(
        "SELECT DISTINCT controller FROM ticks WHERE seq BETWEEN ? AND ? ORDER BY 1", (first_seq, last_seq)
    )
    return {
        "start_utc": datetime.fromtimestamp(ticks[0][2], UTC).isoformat(timespec="milliseconds"),
        "history_id": connection.execute("SELECT id FROM history").fetchone()[0],
        "first_seq": str(first_seq),
        "last_seq": str(last_seq),
        "controllers": ", ".join(name for (name,) in controllers),
    }
