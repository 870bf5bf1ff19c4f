"""Reads what the page shows of the history: a course of the last days, events, and how far back it goes.

Plain SQL on a connection that can't write. Long spans are brought down to few points by SQLite itself: a
year has half a million ticks, and the answer has to come within a blink.
"""

import shutil
import sqlite3
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from edge.core.errors import RequestError
from edge.storage import run_rows

Json = dict[str, Any]

SPAN_MAX_S = 8 * 86_400.0  # of ticks; a longer one is read from the ten-minute table
POINTS_MAX = 2000
EVENTS_MAX = 200
BUSY_S = 1.0
AIR, ROOM = "temp_air_c", "temp_ambient_c"
COLUMNS = ("utc", "air_c", "air_low_c", "air_high_c", "estimate_c", "reference_c", "room_c", "heater", "fan")
# What the board did not confirm counts as off, as it does in the loop. A bucket without a tick is not there.
_TICKS = f"""
SELECT min(t.utc), avg(a.value), min(a.value), max(a.value), avg(t.estimate_temp_air_c), avg(t.reference_c),
    avg(t.estimate_temp_ambient_c),
    avg(CASE WHEN t.echo_trip_cause IS NULL THEN 0.0 ELSE t.echo_heater_duty END),
    avg(CASE WHEN t.echo_trip_cause IS NULL THEN 0.0 ELSE t.echo_fan_on END)
FROM ticks t LEFT JOIN readings a ON a.seq = t.seq AND a.signal = '{AIR}' AND a.quality = 'good'
WHERE t.utc >= :first AND t.utc < :last AND t.seq > 0
GROUP BY CAST((t.utc - :first) / :width AS INTEGER) ORDER BY 1
"""
_WINDOWS = f"""
SELECT start_utc,
    max(CASE quantity WHEN '{AIR}' THEN mean END), max(CASE quantity WHEN '{AIR}' THEN low END),
    max(CASE quantity WHEN '{AIR}' THEN high END), NULL,
    max(CASE quantity WHEN 'reference_c' THEN mean END), max(CASE quantity WHEN '{ROOM}' THEN mean END),
    max(CASE quantity WHEN 'heater_duty' THEN mean END), max(CASE quantity WHEN 'fan_on' THEN mean END)
FROM ten_minutes WHERE start_utc >= :first AND start_utc < :last
GROUP BY CAST((start_utc - :first) / :width AS INTEGER) ORDER BY 1
"""


def course(path: Path, first_utc: float, last_utc: float, points: int) -> Json:
    """Return the columns COLUMNS between two times, at most `points` rows; null where nothing is known.

    Errors : DataError; RequestError for times that are no span
    """
    points = min(max(points, 2), POINTS_MAX)
    span_s = last_utc - first_utc
    if not 0.0 < span_s < 1e9:
        raise RequestError("from_utc has to be before to_utc")
    given = {"first": first_utc, "last": last_utc, "width": max(span_s / points, 1e-3)}
    with reading(path) as db:
        rows = db.execute(_WINDOWS, given).fetchall()
        if span_s <= SPAN_MAX_S:
            rows += db.execute(_TICKS, given).fetchall()
    columns = list(zip(*rows, strict=True)) or [()] * len(COLUMNS)
    return {name: [_round(value) for value in column] for name, column in zip(COLUMNS, columns, strict=True)}


def span(path: Path) -> Json:
    """Return the times of the first and the newest record, null without any, and the disk's room [MB].

    Errors: DataError
    """
    with reading(path) as db:
        newest = db.execute("SELECT max(utc) FROM ticks WHERE seq > 0").fetchone()[0]
        oldest = [
            db.execute(f"SELECT min({column}) FROM {table}").fetchone()[0]
            for table, column in (("ticks", "utc"), ("ten_minutes", "start_utc"))
        ]
    known = [utc for utc in oldest if utc is not None]
    free_mb = round(shutil.disk_usage(path).free / 1e6)
    return {"first_utc": min(known, default=None), "newest_utc": newest, "free_mb": free_mb}


def events(path: Path, before_utc: float | None, severities: tuple[str, ...], most: int) -> list[Json]:
    """Return events of these severities, the newest first. Errors: DataError

    before_utc : None for the newest
    """
    marks = ", ".join("?" * len(severities))
    query = (
        f"SELECT seq, number, utc, key, severity, text FROM events WHERE severity IN ({marks}) AND utc < ?"
        " ORDER BY utc DESC, seq DESC, number DESC LIMIT ?"
    )
    values = (*severities, 1e12 if before_utc is None else before_utc, min(max(most, 1), EVENTS_MAX))
    with reading(path) as db:
        rows = db.execute(query, values).fetchall()
    return [dict(zip(("seq", "number", "utc", "key", "severity", "text"), row, strict=True)) for row in rows]


def reading(path: Path) -> AbstractContextManager[sqlite3.Connection]:
    """Open the history for reading alone. Errors: DataError

    After a clean end there is no log, and who may not write to the folder cannot make one: then nobody
    writes, and the file is read as it is.
    """
    has_log = path.with_name(f"{path.name}-wal").exists()
    return run_rows.reading(path, BUSY_S, "mode=ro" if has_log else "mode=ro&immutable=1")


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
