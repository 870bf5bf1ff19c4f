"""The check for damage, a slice of each table at a time, the newest rows first.

A whole `PRAGMA quick_check` reads all of a year's file in one go: minutes on a slow card. A slice reads
some hundred rows of each table and index in milliseconds.
"""

import math
import sqlite3
from contextlib import closing
from pathlib import Path

SLICE_ROWS = 200  # of each tree: some milliseconds a tick, and the default year is read in two days
_ORDERS = (  # table and the column whose order is walked: each is a tree of pages of its own in the file
    *(("ticks", "seq"), ("ticks", "utc"), ("events", "seq"), ("events", "utc"), ("readings", "seq")),
    *(("decisions", "seq"), ("forecasts", "seq"), ("changes", "seq"), ("ten_minutes", "start_utc")),
    *(("skill", "hour_utc"), ("gaps", "rowid"), ("outbox", "id"), ("outbox", "seq")),
)


class SliceCheck:
    """One pass over the history at `path`."""

    def __init__(self, path: Path, busy_s: float) -> None:
        self._path, self._busy_s = path, busy_s
        self._below = dict.fromkeys(_ORDERS, math.inf)  # of each order that has rows left

    def step(self) -> bool:
        """Read the next slice. Returns whether rows are left. Errors: sqlite3.Error, for damage too

        The connection is new each time: an old one's cache can hide for long what the disk has lost.
        """
        if self._below:
            place = f"{self._path.absolute().as_uri()}?mode=ro"  # never makes a file where one was deleted
            with closing(sqlite3.connect(place, uri=True, timeout=self._busy_s)) as connection:
                self._below = {
                    order: lowest
                    for order, below in self._below.items()
                    if (lowest := _read_slice(connection, *order, below)) is not None
                }
        return bool(self._below)


def _read_slice(connection: sqlite3.Connection, table: str, key: str, below: float) -> float | None:
    """Read the rows whose keys come next below `below`. Returns the lowest key, None where there is none."""
    newest = f"SELECT {key} AS key FROM {table} WHERE {key} < ? ORDER BY {key} DESC LIMIT {SLICE_ROWS}"
    lowest = connection.execute(f"SELECT min(key) FROM ({newest})", (below,)).fetchone()[0]
    if lowest is None:
        return None
    columns = [name for (name,) in connection.execute("SELECT name FROM pragma_table_info(?)", (table,))]
    # A length needs the whole value, also one that is continued on further pages.
    lengths = ", ".join(f"total(length({column}))" for column in columns)
    connection.execute(
        f"SELECT {lengths} FROM {table} WHERE {key} >= ? AND {key} < ?", (lowest, below)
    ).fetchone()
    return float(lowest)
