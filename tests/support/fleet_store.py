"""The stores of a fleet, read from the engines themselves, and the wait until all of it is there."""

import time
from collections.abc import Iterable

from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from fleet.database.tables import StoredSpan
from fleet.numbers.series import selector
from fleet.numbers.victoria import Numbers, NumbersError
from tests.support.fleet_rig import RigWithoutBoard

DAY_S = 86400.0
BROKER = "allow_anonymous true\npersistence true\nmax_queued_messages 0\nmax_inflight_messages 0"


def numbers_of(numbers: Numbers, quantity: str, rig: str) -> list[tuple[float, float]]:
    """Time and value of each sample, rising."""
    rows = numbers.series(selector(quantity, rig=rig), 0.0, time.time() + DAY_S)
    return [pair for series in rows for pair in zip(series.utc, series.values, strict=True)]


def spans_of(engine: Engine, rig: str) -> list[tuple[int, int]]:
    with Session(engine) as session:
        rows = session.execute(
            select(StoredSpan.first_seq, StoredSpan.last_seq)
            .where(StoredSpan.rig == rig)
            .order_by(StoredSpan.first_seq)
        )
        return [(first, last) for first, last in rows]


def what_is_wrong(rigs: Iterable[RigWithoutBoard], numbers: Numbers, engine: Engine) -> str:
    """Say where the stores differ from what rigs have sent, "" when each tick is there exactly once."""
    try:
        for rig in rigs:
            spans = spans_of(engine, rig.name)
            if spans != [(min(rig.sent), max(rig.sent))]:
                return f"{rig.name}: spans {spans}, sent {min(rig.sent)} to {max(rig.sent)}"
            found = numbers_of(numbers, "seq", rig.name)
            if found != [(utc, float(seq)) for seq, utc in rig.sent.items()]:
                return f"{rig.name}: {len(found)} ticks in VictoriaMetrics, {len(rig.sent)} sent"
            airs = numbers_of(numbers, "temp_air_c", rig.name)
            if [value for _, value in airs] != [20.0 + seq % 100 / 10 for seq in rig.sent]:
                return f"{rig.name}: {len(airs)} air temperatures, {len(rig.sent)} sent"
    except NumbersError as error:
        return str(error)
    return ""


def wait_until_all_is_stored(
    rigs: Iterable[RigWithoutBoard],
    numbers: Numbers,
    engine: Engine,
    patience_s: float = 120.0,
    say: str = "",
) -> float:
    """Return how long it took [s]."""
    known, start_s = list(rigs), time.monotonic()
    while wrong := what_is_wrong(known, numbers, engine):
        assert time.monotonic() - start_s < patience_s, f"{wrong}; {say}"
        time.sleep(0.2)
    return time.monotonic() - start_s
