"""Old ticks become ten-minute rows, older rows go; a little at a time, so that the writer is never held long.

A tick's age is counted against the smallest wall clock time among the last CLOCK_TICKS ticks, not against the
clock of this moment: a clock that stood wrong for a while (no battery, no network yet) then deletes nothing.
A tick dated in the future or before its neighbours has a wrong date, so its number decides: it is as old as
the ticks around it, and none waits for it. Ticks of a named run are never deleted.
"""

import json
import math
import sqlite3

from edge.config.settings import HistorySettings

WINDOW_S = 600  # width of a row of `ten_minutes`
CHUNK_ROWS = 500  # ticks thinned, and rows deleted per table, in one transaction
CLOCK_TICKS = 1000
OUTBOX_MAX = 500_000  # messages; at 60 s steps most of a year without a broker
VACUUM_BYTES = 800 << 10  # given back to the file system per chunk
DAY_S = 86400.0

_AMONG = "seq IN (SELECT value FROM json_each(:seqs))"
_DOWNSAMPLE = f"""
INSERT INTO ten_minutes
SELECT CAST(utc / {WINDOW_S} AS INTEGER) * {WINDOW_S}, quantity, count(*), avg(value), min(value), max(value)
FROM (
    SELECT utc, signal AS quantity, value FROM readings JOIN ticks USING (seq)
    WHERE {_AMONG} AND quality = 'good'
    UNION ALL SELECT utc, 'estimate_temp_air_c', estimate_temp_air_c FROM ticks WHERE {_AMONG}
    UNION ALL SELECT utc, 'reference_c', reference_c FROM ticks WHERE {_AMONG}
    UNION ALL SELECT utc, 'heater_duty', coalesce(echo_heater_duty, 0.0) FROM ticks WHERE {_AMONG}
    UNION ALL SELECT utc, 'fan_on', coalesce(echo_fan_on, 0) FROM ticks WHERE {_AMONG}
)
WHERE value IS NOT NULL
GROUP BY 1, 2
ON CONFLICT DO UPDATE SET  -- a window that an earlier chunk began
    mean = (mean * rows + excluded.mean * excluded.rows) / (rows + excluded.rows),
    low = min(low, excluded.low),
    high = max(high, excluded.high),
    rows = rows + excluded.rows
"""


def thin(connection: sqlite3.Connection, settings: HistorySettings) -> tuple[bool, int]:
    """Do one chunk. Returns whether more is to be done, and how many unsent messages were dropped."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        now = _recorded_utc(connection)
        seqs = _old_ticks(connection, now - settings.downsample_after_days * DAY_S, now)
        dropped = _bound_outbox(connection, seqs)
        if seqs:
            _downsample(connection, seqs)
        deleted = _delete_old(connection, now - settings.retention_days * DAY_S)
        connection.execute("COMMIT")
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
    # Not execute(): it steps a statement without columns once, and that gives back a single page.
    page_bytes = connection.execute("PRAGMA page_size").fetchone()[0]
    connection.executescript(f"PRAGMA incremental_vacuum({VACUUM_BYTES // page_bytes})")
    return max(len(seqs), deleted, dropped) >= CHUNK_ROWS, dropped


def _recorded_utc(connection: sqlite3.Connection) -> float:
    """Return the time that ages are counted from; -inf without a tick: nothing is old then."""
    newest = "SELECT utc FROM ticks WHERE seq > 0 ORDER BY seq DESC LIMIT ?"
    utc = connection.execute(f"SELECT min(utc) FROM ({newest})", (CLOCK_TICKS,)).fetchone()[0]
    return -math.inf if utc is None else float(utc)


def _old_ticks(connection: sqlite3.Connection, before_utc: float, now_utc: float) -> list[int]:
    """Return the lowest numbers up to the last tick that is older than the first young one by number."""
    # The +: in the order of numbers up to the first that fits; an index by time would read all young ones.
    young = "SELECT seq FROM ticks WHERE seq > 0 AND +utc BETWEEN :before AND :now ORDER BY seq LIMIT 1"
    first = f"ifnull(({young}), 9e18)"
    last = f"SELECT seq FROM ticks WHERE seq < {first} AND +utc < :before ORDER BY seq DESC LIMIT 1"
    rows = connection.execute(
        f"SELECT seq FROM ticks WHERE seq > 0 AND seq <= ({last}) AND NOT EXISTS"  # named runs stay
        " (SELECT 1 FROM runs WHERE seq BETWEEN runs.first_seq AND runs.last_seq) ORDER BY seq LIMIT :rows",
        {"before": before_utc, "now": now_utc, "rows": CHUNK_ROWS},
    )
    return [seq for (seq,) in rows]


def _bound_outbox(connection: sqlite3.Connection, seqs: list[int]) -> int:
    """Drop the messages of ticks that go now, and the oldest of too many."""
    gone = connection.execute(f"DELETE FROM outbox WHERE {_AMONG}", {"seqs": json.dumps(seqs)}).rowcount
    # By their ids, which are never given twice: a count would read all that wait.
    newest = connection.execute("SELECT coalesce(max(id), 0) FROM outbox").fetchone()[0]
    return gone + connection.execute("DELETE FROM outbox WHERE id <= ?", (newest - OUTBOX_MAX,)).rowcount


def _downsample(connection: sqlite3.Connection, seqs: list[int]) -> None:
    """Fold the ticks into their windows. Events stay, they have their own time."""
    chosen = {"seqs": json.dumps(seqs)}
    connection.execute(_DOWNSAMPLE, chosen)
    for table in ("ticks", "readings", "decisions", "forecasts", "changes"):
        connection.execute(f"DELETE FROM {table} WHERE {_AMONG}", chosen)


def _delete_old(connection: sqlite3.Connection, before_utc: float) -> int:
    """Delete windows, skill, events and gaps from before; returns the most rows that went from one table."""
    windows = connection.execute(
        "DELETE FROM ten_minutes WHERE start_utc IN"
        " (SELECT start_utc FROM ten_minutes WHERE start_utc < ? ORDER BY 1 LIMIT ?)",
        (before_utc, CHUNK_ROWS),
    ).rowcount
    skill = connection.execute(
        "DELETE FROM skill WHERE hour_utc IN"
        " (SELECT hour_utc FROM skill WHERE hour_utc < ? ORDER BY 1 LIMIT ?)",
        (before_utc, CHUNK_ROWS),
    ).rowcount
    # Those of kept ticks stay with them.
    events = connection.execute(
        "DELETE FROM events WHERE (seq, number) IN (SELECT seq, number FROM events WHERE utc < ?"
        " AND NOT EXISTS (SELECT 1 FROM ticks WHERE ticks.seq = events.seq) LIMIT ?)",
        (before_utc, CHUNK_ROWS),
    ).rowcount
    gaps = connection.execute("DELETE FROM gaps WHERE utc < ?", (before_utc,)).rowcount
    return max(windows, skill, events, gaps)
