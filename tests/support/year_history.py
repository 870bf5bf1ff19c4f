"""A year of history as the daemon keeps it by default: a month of ticks, ten-minute rows before, all events.

The month is some recorded hours again and again, see `bench.history_year`. The product's own retention thins
its oldest days. A day of those rows and events is repeated back to the year's beginning by SQL.
"""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from bench.history_year import DAY_S, FIRST_UTC, STEP_S, build, index, thin_all
from edge.core.messages import TickRecord

TICKS_A_DAY = round(DAY_S / STEP_S)
RECENT_DAYS = 32  # that are built as ticks, two more than retention leaves
_REPEAT = (
    "CREATE TEMP TABLE days AS"
    " WITH RECURSIVE d(day) AS (SELECT 1 UNION ALL SELECT day + 1 FROM d LIMIT {days}) SELECT day FROM d",
    "INSERT INTO ten_minutes SELECT start_utc - day * 86400, quantity, rows, mean, low, high"
    " FROM ten_minutes, days WHERE start_utc < {utc} + 86400 ORDER BY 1, 2",
    "INSERT INTO events SELECT seq - day * {ticks}, number, utc - day * 86400, key, severity, text"
    " FROM events, days WHERE seq < {first} + {ticks} ORDER BY 1, 2",
)


def build_year(path: Path, template: Sequence[TickRecord], days: int = 365) -> None:
    """Write the history anew. template : ticks that are repeated"""
    before = days - RECENT_DAYS
    first = before * TICKS_A_DAY + 1
    build(path, template, RECENT_DAYS, first)
    index(path)
    thin_all(path)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        values = {"days": before, "ticks": TICKS_A_DAY, "first": first, "utc": FIRST_UTC + before * DAY_S}
        for statement in ("BEGIN", *_REPEAT, "COMMIT"):
            connection.execute(statement.format(**values))
