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
from fleet.database.events import RigEvent
from fleet.database.leases import WorkLease
from fleet.database.rigs import SILENT_S, FleetRig, StoredSpan, are_there
from fleet.database.twins import ToldTwin
from fleet.machine.rig_register import erase_rig
from fleet.numbers.victoria import Numbers
from fleet.settings import DatabaseSettings, NumbersSettings
from tests.support.broker import PATIENCE_S, Broker, free_port, needs_mosquitto, wait_for
from tests.support.fleet_rig import RigWithoutBoard
from tests.support.ingest_process import IngestProcess
from tests.support.mqtt_rig import settings
from tests.support.victoria import Victoria, needs_victoria

DAY_TICKS = 1440
pytestmark = [needs_mosquitto, needs_victoria, pytest.mark.slow]


@dataclass
class Fleet:
    folder: Path
    broker: Broker
    victoria: Victoria
    ingest: IngestProcess
    numbers: Numbers
    engine: Engine
    url: str

    def rig(self, name: str) -> FleetRig | None:
        with Session(self.engine) as session:
            return session.get(FleetRig, name)


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    url = f"sqlite:///{tmp_path}/fleet.db"
    engine = open_database(DatabaseSettings(url=url))
    with Broker(tmp_path, BROKER) as broker, Victoria(tmp_path) as victoria:
        ingest = IngestProcess(tmp_path, {"port": broker.port}, victoria.url, url)
        with ingest:
            numbers = Numbers(NumbersSettings(url=victoria.url))
            yield Fleet(tmp_path, broker, victoria, ingest, numbers, engine, url)
    engine.dispose()


def test_ticks_states_and_events_are_stored(fleet: Fleet) -> None:
    event = Event("board.link_lost", Severity.ALARM, "silent for 3 s", 0.0, 1.7e9)
    with RigWithoutBoard(fleet.folder, "rig-1", fleet.broker.port) as first:
        with RigWithoutBoard(fleet.folder, "rig-2", fleet.broker.port) as second:
            first.tick(events=(event,))
            for _ in range(4):
                first.tick()
                second.tick()
            wait_until_all_is_stored((first, second), fleet.numbers, fleet.engine, say=fleet.ingest.log)
            assert [value for _, value in numbers_of(fleet.numbers, "sent_heater_duty", "rig-1")] == [
                0.35
            ] * 5
            wait_for(lambda: (row := fleet.rig("rig-1")) and row.is_online and row.state["seq"] == 5)
        wait_for(lambda: (row := fleet.rig("rig-2")) and not row.is_online)
    with Session(fleet.engine) as session:
        rows = session.scalars(select(RigEvent)).all()
    assert [(row.rig, row.seq, row.number, row.key, row.severity) for row in rows] == [
        ("rig-1", 1, 0, "board.link_lost", "alarm")
    ]
    assert fleet.ingest.stop() == 0


def test_a_rig_whose_last_will_was_lost_with_the_broker_is_away_by_its_age(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "rig-1", fleet.broker.port) as rig:
        rig.tick()
        wait_until_all_is_stored([rig], fleet.numbers, fleet.engine, say=fleet.ingest.log)
        wait_for(lambda: (row := fleet.rig("rig-1")) and row.is_online and row.state.get("seq") == 1)
        fleet.broker.kill()
    wait_for(lambda: "disconnected from the broker" in fleet.ingest.log)
    row = fleet.rig("rig-1")
    assert row is not None and row.is_online  # its last word
    with Session(fleet.engine) as session:
        for utc, found in ((row.last_utc + 1.0, ["rig-1"]), (row.last_utc + SILENT_S, [])):
            assert row.is_there(utc) == bool(found)
            assert session.scalars(select(FleetRig.name).where(are_there(utc))).all() == found


def test_what_the_broker_had_kept_of_a_rig_is_no_word_of_it(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "rig-1", fleet.broker.port) as rig:
        rig.tick()
        wait_until_all_is_stored([rig], fleet.numbers, fleet.engine, say=fleet.ingest.log)
        wait_for(lambda: (row := fleet.rig("rig-1")) and row.is_online and row.state.get("seq") == 1)
        before = fleet.rig("rig-1")
        fleet.ingest.kill()
        with Session(fleet.engine) as session, session.begin():
            session.get_one(FleetRig, "rig-1").state = {}
        fleet.ingest.start()
        wait_for(lambda: (row := fleet.rig("rig-1")) and row.state.get("seq") == 1)  # as retained
        after = fleet.rig("rig-1")
        assert before is not None and after is not None and before.last_utc == after.last_utc > 0.0
        rig.tick()
        wait_for(lambda: (row := fleet.rig("rig-1")) and row.last_utc > after.last_utc)


def test_a_rig_that_was_erased_and_comes_again_is_asked_for_its_old_ticks(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "rig-1", fleet.broker.port) as rig:
        for _ in range(3):
            rig.tick()
        wait_until_all_is_stored([rig], fleet.numbers, fleet.engine, say=fleet.ingest.log)
        rig.disconnect()
        remove_retained(settings(fleet.broker.port, rig="rig-1"))
        wait_for(lambda: (row := fleet.rig("rig-1")) and not row.is_online)
        erase_rig(fleet.engine, fleet.numbers, "rig-1")
        rig.connect()
        rig.tick()
        wait_until_all_is_stored([rig], fleet.numbers, fleet.engine, say=fleet.ingest.log)


def test_a_twin_is_kept_while_it_runs(fleet: Fleet) -> None:
    def told() -> ToldTwin | None:
        with Session(fleet.engine) as session:
            return session.get(ToldTwin, "rig-1")

    path = fleet.folder / "box-2" / "twin.yaml"
    path.parent.mkdir()
    write_twin_file(TwinFile(effects={"wall_loss": {"UA": Value(2.5)}}, provenance={"runs": 3}), path)
    with RigWithoutBoard(fleet.folder, "rig-1", fleet.broker.port) as rig:
        rig.twin = path
        wait_for(told)
        kept = told()
        assert kept is not None and kept.bundle == "box-2" and kept.document["provenance"] == {}
        assert twin_of(kept.document).effects["wall_loss"]["UA"].value == 2.5
        rig.twin = None
        wait_for(lambda: told() is None)


def test_an_outbox_of_a_day_comes_in_order_and_whole(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "rig-1", fleet.broker.port) as rig:
        begin = round(time.time()) - 60.0 * DAY_TICKS
        rig.tick(utc=begin)
        wait_until_all_is_stored([rig], fleet.numbers, fleet.engine)
        rig.disconnect()
        for number in range(1, DAY_TICKS):
            rig.tick(utc=begin + 60.0 * number, waits=number == DAY_TICKS - 1)
        rig.connect()
        wait_until_all_is_stored([rig], fleet.numbers, fleet.engine, say=fleet.ingest.log)
    assert "refused" not in fleet.ingest.log


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
    with RigWithoutBoard(fleet.folder, "rig-1", fleet.broker.port) as rig:
        rig.tick()
        wait_until_all_is_stored([rig], fleet.numbers, fleet.engine, say=fleet.ingest.log)
        fleet.victoria.kill()
        rig.tick()
        wait_for(lambda: "numbers.url" in fleet.ingest.log, "a batch that cannot be stored")
        assert fleet.ingest.stop() == 0
        fleet.victoria.start()
        fleet.ingest.start()
        wait_until_all_is_stored([rig], fleet.numbers, fleet.engine, say=fleet.ingest.log)


def test_a_second_ingest_waits_and_goes_on_where_the_first_one_died(fleet: Fleet) -> None:
    other = fleet.folder / "other"
    other.mkdir()
    with (
        IngestProcess(other, {"port": fleet.broker.port}, fleet.victoria.url, fleet.url) as second,
        RigWithoutBoard(fleet.folder, "rig-1", fleet.broker.port) as rig,
    ):
        wait_for(lambda: "connected to the broker" in fleet.ingest.log + second.log)
        waits, runs = (fleet.ingest, second) if "connected" in second.log else (second, fleet.ingest)
        wait_for(lambda: "this one waits until it ends" in waits.log)
        rig.tick()
        wait_until_all_is_stored((rig,), fleet.numbers, fleet.engine, say=runs.log)
        assert "connected" not in waits.log and "disconnected" not in runs.log
        runs.kill()
        rig.tick()
        wait_until_all_is_stored((rig,), fleet.numbers, fleet.engine, say=waits.log)
        assert waits.stop() == 0


def test_an_ingest_that_was_taken_for_dead_writes_nothing_more_and_ends(fleet: Fleet) -> None:
    with RigWithoutBoard(fleet.folder, "rig-1", fleet.broker.port) as rig:
        rig.tick()
        wait_until_all_is_stored((rig,), fleet.numbers, fleet.engine, say=fleet.ingest.log)
        with Session(fleet.engine) as session, session.begin():
            session.execute(update(WorkLease).values(holder="another"))
        rig.tick()
        process = fleet.ingest.process
        assert process is not None and process.wait(PATIENCE_S) == 2
        assert "what rigs send: another process does it now" in fleet.ingest.log
        with Session(fleet.engine) as session:
            assert session.scalars(select(StoredSpan.last_seq)).all() == [1]
        fleet.ingest.start()  # as systemd does; the broker sends what was not acknowledged again
        wait_until_all_is_stored((rig,), fleet.numbers, fleet.engine, say=fleet.ingest.log)
