"""The history for a language model: one guarded SELECT over the read views, and how much of it is covered.

Beside `mode=ro` and `query_only` an authorizer is asked for everything that a statement would touch. Of a
base table it sees which view reads it, but it takes the name of a common table expression for a view's
(`WITH v_ticks AS (SELECT * FROM ticks) ...`), so WITH is refused as a word; a keyword can't be spelt
otherwise.
"""

import math
import re
import sqlite3
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge.assistant.llm.ledger import ToolError
from edge.assistant.llm.wire import ToolSpec
from edge.core.names import SIGNALS
from edge.formats.owner import open_database
from edge.formats.reader import DocumentError, read
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
    connection = open_database(path, "mode=ro", timeout=BUSY_S, isolation_level=None)
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


UNITS = {  # by the ending of a column's name
    "_c": "degC",
    "_k": "K",
    "_pct": "%",
    "_ppm": "ppm",
    "_s": "s",
    "utc": "s since 1970",
    "_min": "min",
    "_duty": "0 to 1",
    "_on": "0 or 1",
}
_TIMES = ("utc", "start_utc", "hour_utc")


def coverage(
    history: Path, columns: Sequence[str], rows: Sequence[Sequence[Any]], truncated: bool, utc: float
) -> dict[str, Any]:
    """Return the coverage of the rows found, and of the whole record that was searched.

    truncated : there were more rows than are shown
    Errors : sqlite3.Error
    """
    with closing(open_guarded(history)) as connection:
        # Three queries: each of them alone is answered by an index.
        count, first, last = (
            connection.execute(f"SELECT {value} FROM v_ticks").fetchone()[0]
            for value in ("count(*)", "min(utc)", "max(utc)")
        )
        span = _span(columns, rows) or (first, last)
        gaps = 0
        if None not in span:
            found = connection.execute("SELECT count(*) FROM v_gaps WHERE utc BETWEEN ? AND ?", span)
            gaps = int(found.fetchone()[0])
    return {
        "rows": len(rows),
        "truncated": truncated,
        "first_utc": span[0],
        "last_utc": span[1],
        "gaps": gaps,
        "recorded_ticks": count,
        "newest_tick_age_s": None if last is None else round(utc - last, 1),
        "units": {column: unit for column in columns if (unit := _unit(column))},
        "note": _note(len(rows), count, truncated),
    }


def _note(rows: int, recorded: int, truncated: bool) -> str:
    if not recorded:
        return "nothing has been recorded yet"
    if not rows:
        return "no row matches; that is not the same as nothing recorded, see recorded_ticks"
    return "there are more rows than these" if truncated else "these are all rows that match"


def _span(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> tuple[float, float] | None:
    """Return the time span of the rows, if they have times."""
    place = next((columns.index(name) for name in _TIMES if name in columns), None)
    if place is None:
        return None
    times = [row[place] for row in rows if isinstance(row[place], int | float)]
    return (min(times), max(times)) if times else None


def _unit(column: str) -> str:
    return next((unit for ending, unit in UNITS.items() if column.endswith(ending)), "")


NAME = "sql"
ROWS_MAX = 200
CELL_MAX = 400  # characters
ANSWER_MAX = 24_000  # characters of all rows
_DESCRIPTION = (
    "Reads the rig's history: one SQLite SELECT (no WITH, no PRAGMA), at most "
    f"{ROWS_MAX} rows. Views: "
    "v_ticks(seq, utc, time, step_s, mode, controller, "
    f"{', '.join(signal.key for signal in SIGNALS.values())}, "
    "estimate_temp_air_c, reference_c, wanted_heater_duty, "
    "wanted_fan_on, sent_heater_duty, sent_fan_on, heater_duty, fan_on, led, link_up, ticks_skipped): a row "
    "per control step; heater_duty and fan_on are what the board confirmed from utc on for step_s. "
    "v_changes(seq, utc, rule, actuator, wanted, sent, reason): what safety changed. "
    "v_decisions(seq, utc, controller, forecast_c, why). v_events(seq, utc, key, severity, text). "
    "v_ten_minutes(start_utc, quantity, rows, mean, low, high): older than the ticks. "
    "v_gaps(first_seq, last_seq, utc, reason): ticks that were lost. "
    "v_forecasts(seq, utc, predictor, horizon_min, temp_c, low_c, high_c, outside). "
    "v_skill(hour_utc, predictor, horizon_min, version, scored, mae_k, ...). "
    f"Units: {', '.join(f'{ending} {unit}' for ending, unit in UNITS.items())}."
)


@dataclass(frozen=True, slots=True)
class SqlArguments:
    """The arguments of a call."""

    query: str


class SqlTool:
    """Opens the history anew for each statement."""

    spec = ToolSpec(
        NAME,
        _DESCRIPTION,
        {
            "type": "object",
            "properties": {"query": {"type": "string", "description": "one SELECT statement"}},
            "required": ["query"],
            "additionalProperties": False,
        },
    )

    def __init__(self, history: Path, utc: Callable[[], float]) -> None:
        self._history = history
        self._utc = utc

    def excerpt(self, result: Mapping[str, Any]) -> Mapping[str, Any]:
        """All of it."""
        return result

    def call(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Columns, rows and coverage. Errors: ToolError; its text is SQLite's, for the model to learn from"""
        try:
            query = read(SqlArguments, arguments).query
        except DocumentError as error:
            raise ToolError(str(error)) from None
        if reason := refusal(query):
            raise ToolError(reason)
        try:
            with closing(open_guarded(self._history)) as connection:
                columns, rows = _select(connection, query)
        except (sqlite3.Error, sqlite3.Warning, ValueError) as error:  # ValueError: a lone surrogate
            raise ToolError(f"the history says: {error}") from None
        kept = _fitting(rows[:ROWS_MAX])
        said = {"columns": columns, "rows": kept}
        return said | {"coverage": self._coverage(columns, kept, len(kept) < len(rows))}

    def _coverage(self, columns: Sequence[str], rows: Sequence[Sequence[Any]], cut: bool) -> dict[str, Any]:
        try:
            return coverage(self._history, columns, rows, cut, self._utc())
        except sqlite3.Error as error:
            raise ToolError(f"the history says: {error}") from None


def _select(connection: sqlite3.Connection, query: str) -> tuple[list[str], list[list[Any]]]:
    """One row more than is shown, so that it is known whether there are more.

    As a subquery nothing but a single SELECT is a statement at all.
    """
    inner = query.strip().removesuffix(";")
    cursor = connection.execute(f"SELECT * FROM ({inner}\n) LIMIT {ROWS_MAX + 1}")
    columns = [str(item[0]) for item in cursor.description]
    return columns, [[_cell(value) for value in row] for row in cursor]


def _cell(value: Any) -> Any:
    """Return a JSON value, a text cut to a reasonable length."""
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    if isinstance(value, str) and len(value) > CELL_MAX:
        return value[:CELL_MAX] + f"... ({len(value)} characters)"
    return value


def _fitting(rows: list[list[Any]]) -> list[list[Any]]:
    """As many rows as an answer may hold."""
    left = ANSWER_MAX
    for count, row in enumerate(rows):
        left -= sum(len(str(value)) + 2 for value in row)
        if left < 0:
            return rows[:count]
    return rows
