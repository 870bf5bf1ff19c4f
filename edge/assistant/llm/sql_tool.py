"""The history for a language model: one SELECT over the read views, answered with what it covers."""

import math
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge.assistant.llm.coverage import UNITS, coverage
from edge.assistant.llm.ledger import ToolError
from edge.assistant.llm.sql_guard import open_guarded, refusal
from edge.assistant.llm.wire import ToolSpec
from edge.core.names import SIGNALS
from edge.formats.reader import DocumentError, read

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
