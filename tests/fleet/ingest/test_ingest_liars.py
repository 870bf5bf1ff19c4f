"""A rig that lies: its messages are counted and refused, and every other rig is served."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fleet_store import BROKER, wait_until_all_is_stored
from history_records import tick
from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from bench.default_daemon import memory_of
from edge.formats.tick_json import tick_json
from fleet.database.base import open_database
from fleet.database.tables import FleetRig, Refusal
from fleet.numbers.victoria import Numbers
from fleet.settings import DatabaseSettings, NumbersSettings
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.fleet_rig import RigWithoutBoard
from tests.support.ingest_process import IngestProcess
from tests.support.victoria import Victoria, needs_victoria

pytestmark = [needs_mosquitto, needs_victoria, pytest.mark.slow]
LIAR = "greenhouse/liar/history/tick"
MEMORY_MAX_MB = 150.0  # beyond the process without lies
RIGS_MAX = 3


def body(seq: int, **changes: Any) -> str:
    made = tick_json(tick(seq, utc=time.time()))
    return json.dumps({"history_id": "h1", "is_resend": 0, **made, **changes})


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Engine]:
    engine = open_database(DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db"))
    yield engine
    engine.dispose()


def counts(engine: Engine) -> dict[tuple[str, str], int]:
    with Session(engine) as session:
        return {(row.rig, row.reason): row.count for row in session.scalars(select(Refusal))}


def lie(liar: Listener) -> dict[str, int]:
    """Send every lie; return how often each reason has to be counted."""
    liar.send(LIAR, body(10))
    for payload in (b"no JSON", body(11).replace("60.0", "NaN")):
        liar.send(LIAR, payload)
    for _ in range(20):
        liar.send(LIAR, b"x" * (10 << 20))
    liar.send(LIAR, body(12, rig="rig-1"))
    liar.send(LIAR, body(12, reference_c=1e300))
    for utc in (0.0, 4102444800.0):
        liar.send(LIAR, body(12, utc=utc))
    liar.send(LIAR, body(50_000_000))
    liar.send(LIAR, body(-1))
    for number in range(100):
        readings = {f"series_{number}_{more}": {"value": 1.0, "quality": "good"} for more in range(100)}
        liar.send(LIAR, body(13 + number, readings=readings))
    liar.send("greenhouse/liar/state", json.dumps({"seq": 1, "temp_air_c": "warm"}))
    liar.send("greenhouse/liar/availability", "yes")
    return {"json": 2, "size": 20, "name": 1, "value": 3, "time": 2, "jump": 1, "seq": 1, "quantity": 100}


def test_lies_are_counted_and_harm_nobody_else(tmp_path: Path, database: Engine) -> None:
    with (
        Broker(tmp_path, BROKER) as broker,
        Victoria(tmp_path) as victoria,
        IngestProcess(
            tmp_path, {"port": broker.port}, victoria.url, f"sqlite:///{tmp_path}/fleet.db", rigs_max=RIGS_MAX
        ) as ingest,
        RigWithoutBoard(tmp_path, "rig-1", broker.port) as honest,
        Listener(broker.port, "nothing", name="liar") as liar,
    ):
        numbers = Numbers(NumbersSettings(url=victoria.url))
        honest.tick()
        wait_until_all_is_stored([honest], numbers, database, say=ingest.log)
        assert ingest.process is not None
        before = memory_of(str(ingest.process.pid)).rss
        expected = lie(liar)
        honest.tick()
        for number in range(50):
            liar.send(f"greenhouse/made-up-{number}/availability", "online")
        honest.tick()
        wait_until_all_is_stored([honest], numbers, database, say=ingest.log)
        wait_for(
            lambda: {reason: counts(database).get(("liar", reason)) for reason in expected} == expected,
            f"{expected}, see {tmp_path}/ingest.log",
        )
        with Session(database) as session:
            assert set(session.scalars(select(FleetRig.name))) == {"rig-1", "liar", "made-up-0"}
        wait_for(lambda: counts(database).get(("", "rig")) == 50 - (RIGS_MAX - 2))
        assert not any(rig == "rig-1" for rig, _ in counts(database))
        series = {own.labels["__name__"] for own in numbers.series('{rig="liar"}', 0.0, time.time() + 60.0)}
        assert not any("series" in name for name in series)
        assert memory_of(str(ingest.process.pid)).rss - before < MEMORY_MAX_MB
        assert ingest.log.count("refused, ") <= 15  # of about 180
