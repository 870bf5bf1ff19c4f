"""Alarms in the history that are newer than the last look, and the events that end them."""

from dataclasses import dataclass
from pathlib import Path

from edge.page.alarms.alarm_book import EventPlace
from edge.page.alarms.rig_watch import OVER
from edge.page.history import reading

MOST = 500  # events of one look; the next one goes on behind them
_NEWEST = "SELECT seq, number FROM events ORDER BY seq DESC, number DESC LIMIT 1"
_BETWEEN = f"""
SELECT seq, number, utc, key, severity, text FROM events
WHERE (seq, number) > (?, ?) AND (seq, number) <= (?, ?) AND (severity = 'alarm' OR key LIKE '%{OVER}')
ORDER BY seq, number LIMIT {MOST}
"""


@dataclass(frozen=True, slots=True)
class HistoryEvent:
    """An event of the history. utc : [s since 1970]"""

    place: EventPlace
    utc: float
    key: str
    is_alarm: bool
    text: str


def newest_place(path: Path) -> EventPlace:
    """Return the place of the newest event: alarms begin behind it. Errors: DataError"""
    if not path.exists():
        return EventPlace(0, 0)
    with reading(path) as db:
        return EventPlace(*(db.execute(_NEWEST).fetchone() or (0, 0)))


def events_after(path: Path, last: EventPlace) -> tuple[list[HistoryEvent], EventPlace]:
    """Return alarms and ends behind `last`, the oldest first, and the place up to which was read.

    A history that ends before `last` is another one, which is read from its beginning.
    Errors : DataError
    """
    with reading(path) as db:
        newest = db.execute(_NEWEST).fetchone()
        if newest is None:
            return [], last
        first = (0, 0) if newest[0] < last.seq else (last.seq, last.number)
        rows = db.execute(_BETWEEN, (*first, *newest)).fetchall()
    found = [
        HistoryEvent(EventPlace(seq, number), utc, key, severity == "alarm", text)
        for seq, number, utc, key, severity, text in rows
    ]
    return found, found[-1].place if len(found) == MOST else EventPlace(*newest)
