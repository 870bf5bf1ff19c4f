"""Ticks of real payloads through a real broker into real stores."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from fleet_store import BROKER, numbers_of, wait_until_all_is_stored
from sqlalchemy import Engine, select, update
from sqlalchemy.orm import Session

from edge.core.messages import Event, Severity
from edge.mqtt.telemetry import remove as remove_retained
from edge.twin.twin_file import TwinFile, twin_of, write_twin_file
from edge.twin.value import Value
from fleet.database.base import open_database
from fleet.database.tables import SILENT_S, FleetRig, RigEvent, StoredSpan, ToldTwin, WorkLease, are_there
from fleet.machine.rig_register import erase_rig
from fleet.numbers.victoria import Numbers
from fleet.settings import DatabaseSettings, NumbersSettings
from tests.support.broker import PATIENCE_S, Broker, free_port, needs_mosquitto, wait_for
from tests.support.fleet_rig import RigWithoutBoard
from tests.support.ingest_process import IngestProcess
from tests.support.mqtt_rig import settings
from tests.support.victoria import Victoria, needs_victoria

DAY_TICKS, TICK_S = 288, 300.0
pytestmark = [needs_mosquitto, needs_victoria, pytest.mark.slow]


@dataclass
class Fleet:
    """folder : of a test; log_begin : of what ingest says during it"""

    folder: Path
    broker: Broker
    victoria: Victoria
    ingest: IngestProcess
    numbers: Numbers
    engine: Engine
    url: str
    log_begin: int = 0

    @property
    def log(self) -> str:
        return self.ingest.log[self.log_begin :]

    def wait_until_all_is_stored(self, *rigs: RigWithoutBoard) -> None:
        wait_until_all_is_stored(rigs, self.numbers, self.engine, say=self.log[-3000:])

    def rig(self, name: str) -> FleetRig | None:
        with Session(self.engine) as session:
            return session.get(FleetRig, name)


@pytest.fixture(scope="module")
def engines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """One fleet for all tests: each has rigs of its own names."""
    folder = tmp_path_factory.mktemp("engines")
    url = f"sqlite:///{folder}/fleet.db"
    engine = open_database(DatabaseSettings(url=url))
    with Broker(folder, BROKER) as broker, Victoria(folder) as victoria:
        ingest = IngestProcess(folder, {"port": broker.port}, victoria.url, url)
        with ingest:
            numbers = Numbers(NumbersSettings(url=victoria.url))
            yield Fleet(folder, broker, victoria, ingest, numbers, engine, url)
    engine.dispose()


@pytest.fixture
def fleet(engines: Fleet, tmp_path: Path) -> Fleet:
    """The fleet, of which all runs again that the test before has ended."""
    for part in (engines.broker, engines.victoria, engines.ingest):
        if part.process is None or part.process.poll() is not None:
            part.start()
    engines.folder, engines.log_begin = tmp_path, len(engines.ingest.log)
    return engines


def test_ticks_states_and_events_are_stored(fleet: Fleet) -> None:
    event = Event("board.link_lost", Severity.ALARM, "silent for 3 s", 0.0, 1.7e9)
    with RigWithoutBoard(fleet.folder, "rig-1", fleet.broker.port) as first:
        with RigWithoutBoard(fleet.folder, "rig-2", fleet.broker.port) as second:
            first.tick(events=(event,))
            for _ in range(4):
                first.tick()
                second.tick()
            fleet.wait_until_all_is_stored(first, second)
            assert [value for _, value in numbers_of(fleet.numbers, "sent_heater_duty", "rig-1")] == [
                0.35
            ] * 5
            wait_for(lambda: (row := fleet.rig("rig-1")) and row.is_online and row.state["seq"] == 5)
        wait_for(lambda: (row := fleet.rig("rig-2")) and not row.is_online)
    with Session(fleet.engine) as session:
        rows = session.scalars(select(RigEvent).where(RigEvent.rig == "rig-1")).all()
    assert [(row.rig, row.seq, row.number, row.key, row.severity) for row in rows] == [
        ("rig-1", 1, 0, "board.link_lost", "alarm")
    ]


def test_a_rig_whose_last_will_was_lost_with_the_broker_is_away_by_its_age(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "willing", fleet.broker.port) as rig:
        rig.tick()
        fleet.wait_until_all_is_stored(rig)
        wait_for(lambda: (row := fleet.rig("willing")) and row.is_online and row.state.get("seq") == 1)
        fleet.broker.kill()
    wait_for(lambda: "disconnected from the broker" in fleet.log)
    row = fleet.rig("willing")
    assert row is not None and row.is_online  # its last word
    with Session(fleet.engine) as session:
        for utc, is_there in ((row.last_utc + 1.0, True), (row.last_utc + SILENT_S, False)):
            assert row.is_there(utc) == is_there
            assert ("willing" in session.scalars(select(FleetRig.name).where(are_there(utc)))) == is_there


def test_what_the_broker_had_kept_of_a_rig_is_no_word_of_it(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "kept", fleet.broker.port) as rig:
        rig.tick()
        fleet.wait_until_all_is_stored(rig)
        wait_for(lambda: (row := fleet.rig("kept")) and row.is_online and row.state.get("seq") == 1)
        before = fleet.rig("kept")
        fleet.ingest.kill()
        with Session(fleet.engine) as session, session.begin():
            session.get_one(FleetRig, "kept").state = {}
        fleet.ingest.start()
        wait_for(lambda: (row := fleet.rig("kept")) and row.state.get("seq") == 1)  # as retained
        after = fleet.rig("kept")
        assert before is not None and after is not None and before.last_utc == after.last_utc > 0.0
        rig.tick()
        wait_for(lambda: (row := fleet.rig("kept")) and row.last_utc > after.last_utc)


def test_a_rig_that_was_erased_and_comes_again_is_asked_for_its_old_ticks(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "erased", fleet.broker.port) as rig:
        for _ in range(3):
            rig.tick()
        fleet.wait_until_all_is_stored(rig)
        rig.disconnect()
        remove_retained(settings(fleet.broker.port, rig="erased"))
        wait_for(lambda: (row := fleet.rig("erased")) and not row.is_online)
        erase_rig(fleet.engine, fleet.numbers, "erased")
        rig.connect()
        rig.tick()
        fleet.wait_until_all_is_stored(rig)


def test_a_twin_is_kept_while_it_runs(fleet: Fleet) -> None:
    def told() -> ToldTwin | None:
        with Session(fleet.engine) as session:
            return session.get(ToldTwin, "told")

    path = fleet.folder / "box-2" / "twin.yaml"
    path.parent.mkdir()
    write_twin_file(TwinFile(effects={"wall_loss": {"UA": Value(2.5)}}, provenance={"runs": 3}), path)
    with RigWithoutBoard(fleet.folder, "told", fleet.broker.port) as rig:
        rig.twin = path
        wait_for(told)
        kept = told()
        assert kept is not None and kept.bundle == "box-2" and kept.document["provenance"] == {}
        assert twin_of(kept.document).effects["wall_loss"]["UA"].value == 2.5
        rig.twin = None
        wait_for(lambda: told() is None)


def test_an_outbox_of_a_day_comes_in_order_and_whole(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "away", fleet.broker.port) as rig:
        begin = round(time.time()) - TICK_S * DAY_TICKS
        rig.tick(utc=begin)
        fleet.wait_until_all_is_stored(rig)
        rig.disconnect()
        for number in range(1, DAY_TICKS):
            rig.tick(utc=begin + TICK_S * number, waits=number == DAY_TICKS - 1)
        rig.connect()
        fleet.wait_until_all_is_stored(rig)
    assert "refused" not in fleet.log


def test_a_store_that_would_keep_a_tick_twice_is_refused(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/fleet.db"
    with (
        Victoria(tmp_path, ("-retentionPeriod=10y",)) as victoria,
        IngestProcess(tmp_path, {"port": free_port()}, victoria.url, url) as ingest,
    ):
        assert ingest.process is not None
        assert ingest.process.wait(PATIENCE_S) == 2
        assert "must be 1ms, or a tick that comes twice is in store twice" in ingest.log


def test_an_end_while_victoria_metrics_is_away_loses_nothing(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "ended", fleet.broker.port) as rig:
        rig.tick()
        fleet.wait_until_all_is_stored(rig)
        fleet.victoria.kill()
        rig.tick()
        wait_for(lambda: "numbers.url" in fleet.log, "a batch that cannot be stored")
        assert fleet.ingest.stop() == 0
        fleet.victoria.start()
        fleet.ingest.start()
        fleet.wait_until_all_is_stored(rig)


def test_a_second_ingest_waits_and_goes_on_where_the_first_one_died(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "waited", fleet.broker.port) as rig:
        rig.tick()
        fleet.wait_until_all_is_stored(rig)
        with IngestProcess(
            fleet.folder, {"port": fleet.broker.port}, fleet.victoria.url, fleet.url
        ) as second:
            wait_for(lambda: "this one waits until it ends" in second.log)
            rig.tick()
            fleet.wait_until_all_is_stored(rig)
            assert "connected" not in second.log and "disconnected" not in fleet.log
            fleet.ingest.kill()
            rig.tick()
            wait_until_all_is_stored((rig,), fleet.numbers, fleet.engine, say=second.log)
            assert second.stop() == 0


def test_an_ingest_that_was_taken_for_dead_writes_nothing_more_and_ends(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "feigned", fleet.broker.port) as rig:
        rig.tick()
        fleet.wait_until_all_is_stored(rig)
        with Session(fleet.engine) as session, session.begin():
            session.execute(update(WorkLease).values(holder="another"))
        rig.tick()
        process = fleet.ingest.process
        assert process is not None and process.wait(PATIENCE_S) == 2
        assert "what rigs send: another process does it now" in fleet.log
        with Session(fleet.engine) as session:
            own = select(StoredSpan.last_seq).where(StoredSpan.rig == "feigned")
            assert session.scalars(own).all() == [1]
        fleet.ingest.start()  # as systemd does; the broker sends what was not acknowledged again
        fleet.wait_until_all_is_stored(rig)
