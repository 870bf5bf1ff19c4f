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
    numbers: Numbers
    database: Engine

    def kill(self, name: str) -> None:
        """End a part at once and start it again."""
        part = getattr(self, name)
        part.kill()
        part.start()

    def wait_until_all_is_stored(self, rigs: list[RigWithoutBoard]) -> None:
        """Also on the disk: what VictoriaMetrics had in memory alone would be missing after one more kill."""
        said = self.ingest.log[-3000:]
        wait_until_all_is_stored(rigs, self.numbers, self.database, STORED_S, said)
        self.kill("victoria")
        assert what_is_wrong(rigs, self.numbers, self.database) == ""


@pytest.fixture(scope="module")
def engines(tmp_path_factory: pytest.TempPathFactory, postgres: Postgres) -> Iterator[Engines]:
    """The engines of all tests here, which die again and again."""
    folder = tmp_path_factory.mktemp("engines")
    with ExitStack() as stack:
        broker = stack.enter_context(Broker(folder, BROKER))
        victoria = stack.enter_context(Victoria(folder))
        url = postgres.new_database()
        database = open_database(DatabaseSettings(url=url))
        stack.callback(database.dispose)
        ingest = stack.enter_context(IngestProcess(folder, {"port": broker.port}, victoria.url, url))
        numbers = Numbers(NumbersSettings(url=victoria.url))
        yield Engines(ingest, broker, victoria, postgres, numbers, database)


@pytest.fixture
def rigs(engines: Engines, tmp_path: Path) -> Iterator[list[RigWithoutBoard]]:
    """Rigs of one test, by its folder's name."""
    names = [f"{tmp_path.name[-20:]}-{number}" for number in (1, 2)]
    with ExitStack() as stack:
        yield [stack.enter_context(RigWithoutBoard(tmp_path, name, engines.broker.port)) for name in names]


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
def test_each_tick_is_in_store_once_after_a_part_was_killed(
    engines: Engines, rigs: list[RigWithoutBoard], part: str
) -> None:
    with ticking(rigs):
        pause(random.Random(part))
        engines.kill(part)
    engines.wait_until_all_is_stored(rigs)


def test_each_tick_is_in_store_once_after_all_parts_were_killed_in_turn(
    engines: Engines, rigs: list[RigWithoutBoard]
) -> None:
    moments = random.Random()  # another course at each run: what fails once is a fault, not a flake
    order = [*PARTS, "broker", "victoria"]
    with ticking(rigs):
        for part in order:
            pause(moments)
            engines.kill(part)
    engines.wait_until_all_is_stored(rigs)


def test_the_last_ticks_before_the_broker_was_killed_are_asked_for(
    engines: Engines, rigs: list[RigWithoutBoard]
) -> None:
    for rig in rigs:
        rig.tick()
    engines.wait_until_all_is_stored(rigs)
    engines.ingest.kill()  # so the broker alone has what comes now, and loses it
    for rig in rigs:
        for _ in range(5):
            rig.tick()
    wait_for(lambda: all(rig.depth() == 0 for rig in rigs), "every outbox is empty")
    engines.kill("broker")
    engines.ingest.start()
    engines.wait_until_all_is_stored(rigs)
