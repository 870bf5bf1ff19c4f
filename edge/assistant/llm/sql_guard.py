"""A connection on which a stranger's SELECT can do no harm: read-only, allow-listed, limited in all it takes.

Beside `mode=ro` and `query_only` an authorizer is asked for everything that a statement would touch. Of a
base table it sees which view reads it, but it takes the name of a common table expression for a view's
(`WITH v_ticks AS (SELECT * FROM ticks) ...`), so WITH is refused as a word; a keyword can't be spelt
otherwise.
"""

import re
import sqlite3
import time
from pathlib import Path
from urllib.parse import quote

from edge.storage.schema_version import VIEWS

FUNCTIONS = frozenset(
    (
        *("abs", "avg", "coalesce", "count", "date", "datetime", "ifnull", "iif", "julianday", "length"),
        *("like", "lower", "max", "min", "nullif", "round", "sign", "strftime", "substr", "sum", "time"),
        *("total", "unixepoch", "upper", "json_extract", "json_each", "lag", "lead", "row_number"),
    )
)
DEADLINE_S = 1.0
STEPS_PER_LOOK = 1000  # of SQLite's machine, between two looks at the clock
LENGTH_MAX = 1 << 18  # of a text or a row [bytes]
BUSY_S = 0.2
_LIMITS = {
    sqlite3.SQLITE_LIMIT_LENGTH: LENGTH_MAX,
    sqlite3.SQLITE_LIMIT_SQL_LENGTH: 8000,
    sqlite3.SQLITE_LIMIT_COLUMN: 100,
    sqlite3.SQLITE_LIMIT_EXPR_DEPTH: 50,
    sqlite3.SQLITE_LIMIT_COMPOUND_SELECT: 10,
    sqlite3.SQLITE_LIMIT_ATTACHED: 0,
    sqlite3.SQLITE_LIMIT_LIKE_PATTERN_LENGTH: 200,
    sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH: 0,
    sqlite3.SQLITE_LIMIT_WORKER_THREADS: 0,
}
_WITH = re.compile(r"\bwith\b", re.IGNORECASE)


def open_guarded(path: Path) -> sqlite3.Connection:
    """For one statement of a stranger and no more. Errors: sqlite3.Error"""
    place = f"file:{quote(str(path.absolute()))}?mode=ro"
    connection = sqlite3.connect(place, uri=True, timeout=BUSY_S, isolation_level=None)
    try:
        connection.execute("PRAGMA query_only = ON")
        connection.execute("SELECT count(*) FROM v_ticks WHERE seq < 0")  # the schema is read, and is ours
        for limit, value in _LIMITS.items():
            connection.setlimit(limit, value)
        connection.set_authorizer(_Authorizer())
        end_s = time.monotonic() + DEADLINE_S
        connection.set_progress_handler(lambda: time.monotonic() > end_s, STEPS_PER_LOOK)
    except BaseException:
        connection.close()
        raise
    return connection


def refusal(statement: str) -> str:
    """Why a statement is not even tried, "" where it may be."""
    if "\0" in statement:
        return "a NUL in the statement"
    return "WITH is not allowed: write a subquery" if _WITH.search(statement) else ""


class _Authorizer:
    """Asked by SQLite while it prepares a statement; whatever is not on a list is denied."""

    def __init__(self) -> None:
        self._view_read = False

    def __call__(
        self, action: int, first: str | None, second: str | None, database: str | None, view: str | None
    ) -> int:
        if action == sqlite3.SQLITE_SELECT:
            return sqlite3.SQLITE_OK
        if action == sqlite3.SQLITE_FUNCTION:
            return _permission(second is not None and second.lower() in FUNCTIONS)
        if action == sqlite3.SQLITE_READ:
            return _permission(self._may_read(first, second, view))
        return sqlite3.SQLITE_DENY

    def _may_read(self, table: str | None, column: str | None, view: str | None) -> bool:
        if table in VIEWS or view in VIEWS:
            self._view_read = True
            return True
        # No column: the rows of a view's table are counted, which is told of after the view.
        return column == "" and self._view_read


def _permission(condition: bool) -> int:
    return sqlite3.SQLITE_OK if condition else sqlite3.SQLITE_DENY
