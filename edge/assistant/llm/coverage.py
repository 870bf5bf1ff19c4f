"""Coverage of a history answer: rows, time span, gaps, age."""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from edge.assistant.llm.sql_guard import open_guarded

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
