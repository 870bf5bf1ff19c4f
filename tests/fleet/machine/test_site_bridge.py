"""A site whose broker is bridged to the fleet's over TLS: rigs, ticks and orders, over cuts and kills."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import pytest
import yaml
from fleet_broker import FleetBroker, fleets_context, unpacked
from fleet_store import wait_until_all_is_stored
from sqlalchemy import Engine
from sqlalchemy.orm import Session

from fleet.database.base import open_database
from fleet.database.tables import FleetRig
from fleet.machine.engine_files import MESSAGE_MAX
from fleet.machine.rig_register import add_to_site
from fleet.machine.site_papers import SITE_HOME
from fleet.numbers.victoria import Numbers
from fleet.settings import load
from tests.support.broker import PATIENCE_S, Broker, Listener, needs_mosquitto, wait_for
from tests.support.fleet_rig import RigWithoutBoard
from tests.support.ingest_process import IngestProcess
from tests.support.victoria import Victoria, needs_victoria

pytestmark = [needs_mosquitto, needs_victoria, pytest.mark.slow]
pytest_plugins = ["rig_places"]
DAY_TICKS = 1440  # and more than mosquitto keeps by itself, 1000
NEVER_S = 3600.0  # ingest asks for nothing in a test: what comes comes by the bridge's queue alone
REPLY_S = 2.0
RIGS = ["tent-1", "tent-2"]
T = TypeVar("T")


@dataclass
class BridgedSite:
    """A fleet with its stores, and the site `school` with a broker of its own."""

    fleet: FleetBroker
    site: Broker
    ingest: IngestProcess
    numbers: Numbers
    engine: Engine

    def rig(self, name: str) -> FleetRig:
        with Session(self.engine) as session:
            return session.get_one(FleetRig, name)

    def chief(self, topic: str) -> Listener:
        """A client that gives orders at the fleet's broker, and hears a topic there."""
        port, tls = self.fleet.machine.ports.broker, fleets_context(self.fleet.places)
        return Listener(port, topic, context=tls, name="chief")

    def wait_until_all_is_stored(self, *rigs: RigWithoutBoard) -> None:
        wait_until_all_is_stored(rigs, self.numbers, self.engine, say=self.ingest.log[-3000:])


def bridge_of(home: Path) -> str:
    """Return settings of a site's broker, its papers where they lie; after a cut it tries again at once."""
    bridge = (home / "bridge.conf").read_text().replace(SITE_HOME, str(home))
    return "allow_anonymous true\n" + bridge.replace("\naddress ", "\nrestart_timeout 1\naddress ")


@contextmanager
def bridged(folder: Path, **ingest: float) -> Iterator[BridgedSite]:
    """ingest : its settings"""
    (folder / "broker").mkdir()
    with FleetBroker(folder) as fleet, Victoria(folder) as victoria:
        archive = folder / "school.tar.gz"
        assert add_to_site(fleet.places, "school", RIGS, "north", "tent", archive) == (True, True)
        home = unpacked(archive)
        mqtt = yaml.safe_load(fleet.places.settings.read_text())["mqtt"]
        database = load(fleet.places.settings).database
        engine = open_database(database)
        try:
            with (
                Broker(folder / "broker", bridge_of(home)) as site,
                IngestProcess(folder, mqtt, victoria.url, database.url, **ingest) as process,
            ):
                wait_for(lambda: "connected to the broker" in process.log, "ingest", 3 * PATIENCE_S)
                numbers = Numbers(load(process.settings).numbers)
                yield BridgedSite(fleet, site, process, numbers, engine)
        finally:
            engine.dispose()


def order_until(condition: Callable[[], T], chief: Listener, topic: str, payload: str) -> T:
    """Give an order until `condition()` is true, and return that.

    The rig, or the bridge, may not have subscribed yet.
    """
    deadline = time.monotonic() + 3 * PATIENCE_S
    while time.monotonic() < deadline:
        chief.send(topic, payload)
        until = time.monotonic() + REPLY_S
        while time.monotonic() < until:
            if found := condition():
                return found
            time.sleep(0.02)
    raise AssertionError(f"nothing came of {topic}")


def ask(chief: Listener, rig: str, what: str, payload: str, **own: int) -> dict[str, object]:
    """Give an order until there is an answer.

    own : by which an answer is told from those to ingest
    """
    wanted = {"command": what, **own}.items()

    def answers() -> list[dict[str, object]]:
        return [
            dict(answer) for answer in chief.objects(f"greenhouse/{rig}/reply") if answer.items() >= wanted
        ]

    return order_until(answers, chief, f"greenhouse/{rig}/set/{what}", payload)[0]


def test_ticks_orders_and_resending_go_over_the_bridge(tmp_path: Path) -> None:
    with bridged(tmp_path) as all_of:
        port = all_of.site.port
        with RigWithoutBoard(tmp_path, "tent-2", port) as second:
            with (
                RigWithoutBoard(tmp_path, "tent-1", port) as first,
                all_of.chief("greenhouse/+/reply") as chief,
            ):
                for _ in range(5):
                    first.tick()
                    second.tick()
                all_of.wait_until_all_is_stored(first, second)
                wait_for(lambda: all_of.rig("tent-1").is_online)
                row = all_of.rig("tent-1")
                assert (row.group, row.kind) == ("north", "tent")
                assert ask(chief, "tent-1", "temperature", "26.5")["ok"] is True
                assert first.operation.reference_c == 26.5
                assert second.operation.reference_c is None
                span = {"first_seq": 2, "last_seq": 4}
                asked = ask(chief, "tent-1", "resend", json.dumps(span), **span)
                assert (asked["ok"], asked["queued"]) == (True, 3)
                wait_for(lambda: first.depth() == 0, "the ticks are sent again")
                first.tick()
                all_of.wait_until_all_is_stored(first, second)
            wait_for(lambda: not all_of.rig("tent-1").is_online)
            # One message that is too large for the fleet ends no bridge.
            with Listener(port, "none") as somebody:
                somebody.send("greenhouse/tent-2/event", b" " * (MESSAGE_MAX + 1))
            second.tick()
            all_of.wait_until_all_is_stored(second)
            assert "oversize" not in all_of.fleet.log


def test_a_rig_comes_to_a_site_later(tmp_path: Path) -> None:
    with bridged(tmp_path) as all_of:
        archive, home = tmp_path / "later.tar.gz", tmp_path / "school"
        assert add_to_site(all_of.fleet.places, "school", ["tent-3"], "", "", archive) == (False, True)
        (home / "bridge.conf").write_text((unpacked(archive) / "bridge.conf").read_text())
        all_of.site.stop()
        with (
            Broker(tmp_path / "broker", bridge_of(home)) as site,
            RigWithoutBoard(tmp_path, "tent-3", site.port) as third,
            RigWithoutBoard(tmp_path, "tent-1", site.port) as first,
        ):
            third.tick()
            first.tick()
            all_of.wait_until_all_is_stored(third, first)


@pytest.mark.usefixtures("quick_reconnect")
def test_a_site_that_is_cut_off_for_a_day_loses_nothing(tmp_path: Path) -> None:
    with (
        bridged(tmp_path, gap_wait_s=NEVER_S) as all_of,
        RigWithoutBoard(tmp_path, "tent-1", all_of.site.port) as rig,
    ):
        begin = round(time.time()) - 60.0 * DAY_TICKS
        rig.tick(utc=begin)
        all_of.wait_until_all_is_stored(rig)
        all_of.fleet.stop()
        for number in range(1, DAY_TICKS):
            rig.tick(utc=begin + 60.0 * number, waits=number == DAY_TICKS - 1)
        wait_for(lambda: rig.depth() == 0, "the site's broker has all", 3 * PATIENCE_S)
        all_of.site.stop()  # in good order: it keeps what the fleet has not got
        all_of.fleet.start()
        all_of.site.start()
        all_of.wait_until_all_is_stored(rig)


@pytest.mark.usefixtures("quick_reconnect")
def test_what_a_killed_broker_of_a_site_had_is_asked_for(tmp_path: Path) -> None:
    with bridged(tmp_path) as all_of, RigWithoutBoard(tmp_path, "tent-1", all_of.site.port) as rig:
        rig.tick()
        all_of.wait_until_all_is_stored(rig)
        all_of.fleet.stop()
        for _ in range(50):
            rig.tick()
        wait_for(lambda: rig.depth() == 0, "the site's broker has all")
        all_of.site.kill()
        all_of.fleet.start()
        with all_of.chief("greenhouse/tent-1/reply") as chief:
            all_of.site.start()
            rig.tick()
            all_of.wait_until_all_is_stored(rig)
            answers = "greenhouse/tent-1/reply"
            wait_for(lambda: any(answer["command"] == "resend" for answer in chief.objects(answers)))


def test_an_order_is_not_kept_for_a_site_that_is_away(tmp_path: Path) -> None:
    topic = "greenhouse/tent-1/set/temperature"
    with (
        bridged(tmp_path) as all_of,
        Listener(all_of.site.port, topic) as heard,
        all_of.chief("greenhouse/+/reply") as chief,
        RigWithoutBoard(tmp_path, "tent-1", all_of.site.port),
    ):
        ask(chief, "tent-1", "temperature", "20")
        all_of.site.stop()
        chief.send(topic, "30")
        all_of.site.start()  # the listener's session is in its store: it hears all that comes from now on
        order_until(lambda: b"25" in heard.payloads(topic), chief, topic, "25")
        assert {*heard.payloads(topic)} == {b"20", b"25"}
