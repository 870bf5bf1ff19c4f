"""Reads events of the history, and how far back it goes, on a connection that can't write."""

import shutil
import sqlite3
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from edge.storage import run_rows

Json = dict[str, Any]

EVENTS_MAX = 200
BUSY_S = 1.0


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
    columns = ("seq", "number", "utc", "key", "severity", "text")
    marks = ", ".join("?" * len(severities))
    # The newest by number: after a clock that ran ahead they still come first. It is also the order in which
    # the table lies, so a year without an alarm is read three times as fast as by the index of times.
    older, order = ("", "") if before_utc is None else (" AND utc < ?", "utc DESC, ")
    query = (
        f"SELECT {', '.join(columns)} FROM events WHERE severity IN ({marks}){older}"
        f" ORDER BY {order}seq DESC, number DESC LIMIT ?"
    )
    before = () if before_utc is None else (before_utc,)
    with reading(path) as db:
        rows = db.execute(query, (*severities, *before, min(max(most, 1), EVENTS_MAX))).fetchall()
    return [dict(zip(columns, row, strict=True)) for row in rows]


def has_alarm(path: Path, seq: int, number: int) -> bool:
    """Return whether event `number` of tick `seq` is an alarm. Errors: DataError"""
    query = "SELECT 1 FROM events WHERE seq = ? AND number = ? AND severity = 'alarm'"
    with reading(path) as db:
        return db.execute(query, (seq, number)).fetchone() is not None


def reading(path: Path) -> AbstractContextManager[sqlite3.Connection]:
    """Open the history for reading alone. Errors: DataError

    After a clean end there is no log, and who may not write to the folder cannot make one: then nobody
    writes, and the file is read as it is.
    """
    has_log = path.with_name(f"{path.name}-wal").exists()
    return run_rows.reading(path, BUSY_S, "mode=ro" if has_log else "mode=ro&immutable=1")
