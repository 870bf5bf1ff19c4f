"""Kills of every part while rigs tick: in the end each tick is in store once, the newest ones too."""

import random
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from fleet_store import BROKER, wait_until_all_is_stored, what_is_wrong
from sqlalchemy import Engine

from fleet.database.base import open_database
from fleet.numbers.victoria import Numbers
from fleet.settings import DatabaseSettings, NumbersSettings
from tests.support.broker import Broker, needs_mosquitto, wait_for
from tests.support.fleet_rig import RigWithoutBoard, every
from tests.support.ingest_process import IngestProcess
from tests.support.postgres import Postgres, needs_postgres
from tests.support.victoria import Victoria, needs_victoria

pytestmark = [needs_mosquitto, needs_victoria, needs_postgres, pytest.mark.slow, pytest.mark.timeout(300)]
PARTS = ("ingest", "broker", "victoria", "postgres")
TICK_S = 0.1
STORED_S = 120.0


@dataclass
class Engines:
    ingest: IngestProcess
    broker: Broker
    victoria: Victoria
    postgres: Postgres
    rigs: list[RigWithoutBoard]
    numbers: Numbers
    database: Engine

    def kill(self, name: str) -> None:
        """End a part at once and start it again."""
        part = getattr(self, name)
        part.kill()
        part.start()

    def wait_until_all_is_stored(self) -> None:
        """Also on the disk: what VictoriaMetrics had in memory alone would be missing after one more kill."""
        said = self.ingest.log[-3000:]
        wait_until_all_is_stored(self.rigs, self.numbers, self.database, STORED_S, said)
        self.kill("victoria")
        assert what_is_wrong(self.rigs, self.numbers, self.database) == ""


@pytest.fixture
def engines(tmp_path: Path) -> Iterator[Engines]:
    with ExitStack() as stack:
        broker = stack.enter_context(Broker(tmp_path, BROKER))
        victoria = stack.enter_context(Victoria(tmp_path))
        postgres = stack.enter_context(Postgres())
        database = open_database(DatabaseSettings(url=postgres.url))
        stack.callback(database.dispose)
        ingest = stack.enter_context(
            IngestProcess(tmp_path, {"port": broker.port}, victoria.url, postgres.url)
        )
        names = [f"rig-{number}" for number in (1, 2, 3)]
        rigs = [stack.enter_context(RigWithoutBoard(tmp_path, name, broker.port)) for name in names]
        numbers = Numbers(NumbersSettings(url=victoria.url))
        yield Engines(ingest, broker, victoria, postgres, rigs, numbers, database)


@contextmanager
def ticking(rigs: list[RigWithoutBoard]) -> Iterator[None]:
    """Let each rig tick steadily. The last ticks come at the end of the block, at whatever moment that is."""
    ended = threading.Event()

    def tick_all() -> None:
        for rig in rigs:
            rig.tick()

    thread = threading.Thread(target=every, args=(TICK_S, tick_all, ended.is_set))
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def pause(moments: random.Random) -> None:
    threading.Event().wait(moments.uniform(0.5, 3.0))  # what is killed is at another place each time


@pytest.mark.parametrize("part", PARTS)
def test_each_tick_is_in_store_once_after_a_part_was_killed_twice(engines: Engines, part: str) -> None:
    moments = random.Random(part)
    with ticking(engines.rigs):
        for _ in range(2):
            pause(moments)
            engines.kill(part)
    engines.wait_until_all_is_stored()


def test_each_tick_is_in_store_once_after_all_parts_were_killed_in_turn(engines: Engines) -> None:
    moments = random.Random()  # another course at each run: what fails once is a fault, not a flake
    order = [*PARTS, "broker", "victoria"]
    with ticking(engines.rigs):
        for part in order:
            pause(moments)
            engines.kill(part)
    engines.wait_until_all_is_stored()


def test_the_last_ticks_before_the_broker_was_killed_are_asked_for(engines: Engines) -> None:
    for rig in engines.rigs:
        rig.tick()
    engines.wait_until_all_is_stored()
    engines.ingest.kill()  # so the broker alone has what comes now, and loses it
    for rig in engines.rigs:
        for _ in range(5):
            rig.tick()
    wait_for(lambda: all(rig.depth() == 0 for rig in engines.rigs), "every outbox is empty")
    engines.kill("broker")
    engines.ingest.start()
    engines.wait_until_all_is_stored()
