"""Courses of the history: what was measured, wanted and driven between two times, in few rows.

SQLite brings ticks and ten-minute rows down to means, lows and highs of equal buckets of time. A bucket
before the newest tick is read once: a later look at the same days reads only what is new.
"""

import math
import sqlite3
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

from edge.core.errors import RequestError
from edge.page.history import reading
from edge.storage.retention import WINDOW_S

Json = dict[str, Any]
Row = tuple[Any, ...]  # as COLUMNS

POINTS_MAX = 2000
ROWS_MAX = 6000  # kept, the least used go first: six courses of 1000 points, at most 4 MB
AIR = "temp_air_c"
COLUMNS = ("utc", "air_c", "air_low_c", "air_high_c", "estimate_c", "reference_c", "room_c", "heater", "fan")
# What the board did not confirm counts as off, as it does in the loop. A bucket without a tick is not there.
_TICKS = f"""
SELECT CAST(t.utc / :width AS INTEGER), count(*), min(t.utc), avg(a.value), min(a.value), max(a.value),
    avg(t.estimate_temp_air_c), avg(t.reference_c), avg(t.estimate_temp_ambient_c),
    avg(CASE WHEN t.echo_trip_cause IS NULL THEN 0.0 ELSE t.echo_heater_duty END),
    avg(CASE WHEN t.echo_trip_cause IS NULL THEN 0.0 ELSE t.echo_fan_on END)
FROM ticks t LEFT JOIN readings a ON a.seq = t.seq AND a.signal = '{AIR}' AND a.quality = 'good'
WHERE t.utc >= :first AND t.utc < :last AND t.seq > 0
GROUP BY 1
"""
_NEWEST = "SELECT history.id, seq, utc FROM history, ticks WHERE seq > 0 ORDER BY seq DESC LIMIT 1"
_PLACES = {  # quantity of the ten-minute table -> place of its mean in a row
    name: COLUMNS.index(column)
    for name, column in (
        (AIR, "air_c"),
        ("estimate_temp_air_c", "estimate_c"),
        ("reference_c", "reference_c"),
        ("temp_ambient_c", "room_c"),
        ("heater_duty", "heater"),
        ("fan_on", "fan"),
    )
}
_WINDOWS = f"""
SELECT CAST(start_utc / :width AS INTEGER), quantity, sum(rows), min(start_utc), sum(mean * rows) / sum(rows),
    min(low), max(high)
FROM ten_minutes
WHERE start_utc >= :first AND start_utc < :last AND quantity IN ({", ".join(map(repr, _PLACES))})
GROUP BY 1, 2
"""


class Courses:
    """Reads courses of the history at `path`. Not for two threads at once."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._kept: OrderedDict[tuple[float, int], Row | None] = OrderedDict()  # None: nothing is recorded
        self._seen: tuple[str, int, float] = ("", 0, 0.0)  # the history, its newest tick's number and time

    def between(self, first_utc: float, last_utc: float, points: int) -> Json:
        """Return the columns COLUMNS, at most `points` rows in the order of time, with None for the unknown.

        Errors : DataError; RequestError for times that are no span
        """
        span_s, points = last_utc - first_utc, min(max(points, 2), POINTS_MAX)
        if not 1.0 <= span_s < 1e9:
            raise RequestError("from_utc has to be before to_utc, by a second at least")
        width_s = _width_s(span_s / (points - 1))  # cut at both ends, they are one more
        buckets = range(math.floor(first_utc / width_s), math.floor(last_utc / width_s) + 1)
        with reading(self._path) as db:
            db.execute("BEGIN")  # retention makes windows of ticks meanwhile
            newest_utc = self._look(db)
            found = self._rows(db, width_s, buckets, newest_utc)
        rows = [row for row in found if row is not None and first_utc <= row[0] < last_utc]
        return {name: [row[place] for row in rows] for place, name in enumerate(COLUMNS)}

    def _look(self, db: sqlite3.Connection) -> float:
        """Return the time of the newest tick. Drop all rows if the clock went back, or for another file."""
        history, seq, utc = self._seen
        found = db.execute(_NEWEST).fetchone()
        self._seen = found or ("", 0, 0.0)
        if self._kept:
            earliest = db.execute("SELECT min(+utc) FROM ticks WHERE seq > ?", (seq,)).fetchone()[0]
            went_back = earliest is not None and earliest < utc
            if went_back or self._seen[0] != history or self._seen[1] < seq:
                self._kept.clear()
        return self._seen[2]

    def _rows(
        self, db: sqlite3.Connection, width_s: float, buckets: range, newest_utc: float
    ) -> list[Row | None]:
        """Return a row for each bucket. Keep those that can't change any more."""
        kept = self._kept
        found = {bucket: kept.pop((width_s, bucket)) for bucket in buckets if (width_s, bucket) in kept}
        for first, last in _stretches(bucket for bucket in buckets if bucket not in found):
            read = _read(db, width_s * first, width_s * (last + 1), width_s)
            found.update((bucket, read.get(bucket)) for bucket in range(first, last + 1))
        for bucket in range(buckets.start, min(buckets.stop, math.floor(newest_utc / width_s))):
            kept[width_s, bucket] = found[bucket]
        while len(kept) > ROWS_MAX:
            kept.popitem(last=False)
        return [found[bucket] for bucket in buckets]


def _stretches(numbers: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yield the first and the last of numbers that follow each other."""
    for _, group in groupby(enumerate(numbers), lambda pair: pair[1] - pair[0]):
        found = [number for _, number in group]
        yield found[0], found[-1]


def _width_s(least_s: float) -> float:
    """Return the width of a bucket: a step of a fixed ladder, so that later courses meet the same buckets.

    A wide bucket has whole ten-minute rows in it.
    """
    width_s = float(WINDOW_S * 2.0 ** math.ceil(math.log2(least_s / WINDOW_S)))
    between_s = 0.75 * width_s
    is_step = least_s <= between_s and (between_s < WINDOW_S or between_s % WINDOW_S == 0.0)
    return between_s if is_step else width_s


def _read(db: sqlite3.Connection, first_utc: float, last_utc: float, width_s: float) -> dict[int, Row]:
    given = {"first": first_utc, "last": last_utc, "width": width_s}
    found = _windows(db, given)
    for bucket, *row in db.execute(_TICKS, given):
        found[bucket] = _sum(found[bucket], row) if bucket in found else row
    return {bucket: (row[1], *map(_round, row[2:])) for bucket, row in found.items()}


def _windows(db: sqlite3.Connection, given: dict[str, float]) -> dict[int, list[Any]]:
    """Return rows of ten-minute means by bucket, each behind its number of ticks."""
    found: dict[int, list[Any]] = {}
    for bucket, quantity, ticks, utc, mean, low, high in db.execute(_WINDOWS, given):
        row = found.setdefault(bucket, [ticks, utc, *[None] * (len(COLUMNS) - 1)])
        row[:2] = max(row[0], ticks), min(row[1], utc)
        row[1 + _PLACES[quantity]] = mean
        if quantity == AIR:
            row[3:5] = low, high
    return found


def _sum(one: list[Any], other: list[Any]) -> list[Any]:
    """Return the row of a bucket that has both kinds: where retention stands, and beside a named run."""
    ticks = one[0] + other[0]
    share = other[0] / ticks

    def mean(a: float | None, b: float | None) -> float | None:
        return b if a is None else a if b is None else a + share * (b - a)

    lows, highs = ([row[place] for row in (one, other) if row[place] is not None] for place in (3, 4))
    found = [mean(a, b) for a, b in zip(one, other, strict=True)]
    found[:2] = ticks, min(one[1], other[1])
    found[3:5] = min(lows, default=None), max(highs, default=None)
    return found


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
