"""The recorded tick at a time, and its explanation."""

import sqlite3
from datetime import tzinfo
from pathlib import Path
from typing import Any

from edge.assistant.why.explain import explain
from edge.core.errors import DataError
from edge.core.plain_text import plain
from edge.storage.runs import reading
from edge.storage.tick_rows import read_ticks

Json = dict[str, Any]


def why(path: str | Path, at_utc: float | None, zone: tzinfo | None) -> Json:
    """Why the command that held at `at_utc` was sent, or the newest one where it is None.

    Returns : `seq`, `utc`, and `lines` of text
    Errors : DataError when nothing is recorded there
    """
    try:
        with reading(path) as connection:
            seq = _seq(connection, at_utc)
            if seq is None:
                raise DataError(f"{path}: no tick is recorded {'before that time' if at_utc else 'yet'}")
            record = read_ticks(connection, [seq]).get(seq)
            if record is None:
                raise DataError(f"{path}: tick {seq} is damaged")
    except sqlite3.Error as error:
        raise DataError(f"{path}: {error}") from error
    try:
        lines = explain(record, zone)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:  # its reasons are free
        raise DataError(f"{path}: tick {seq} is damaged: {plain(str(error))}") from None
    if at_utc is not None and at_utc - record.utc > 2 * record.step_s:
        ago = _ago(at_utc - record.utc)
        lines.insert(0, f"Nothing is recorded at that time; the last tick before it was {ago} earlier.")
    return {"seq": seq, "utc": record.utc, "lines": lines}


def _seq(connection: sqlite3.Connection, at_utc: float | None) -> int | None:
    """Return the newest tick that the daemon recorded at or before a time.
    Imported runs have negative numbers.
    """
    before, values = ("", ()) if at_utc is None else ("AND utc <= ?", (at_utc,))
    row = connection.execute(
        f"SELECT seq FROM ticks WHERE seq > 0 {before} ORDER BY utc DESC, seq DESC LIMIT 1", values
    ).fetchone()
    return None if row is None else int(row[0])


def _ago(seconds: float) -> str:
    """Return a length of time in words, in the largest unit of which there are at least two."""
    for unit, length_s in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * length_s:
            return f"{seconds / length_s:.0f} {unit}"
    return f"{seconds:.0f} seconds"
