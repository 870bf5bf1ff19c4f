"""The broker with the files that the fleet writes: each rig its own topics, and none after it is removed."""

import ssl
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from fleet_broker import FleetBroker, answer, connected, context, fleets_context, unpacked
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from sqlalchemy import select
from sqlalchemy.orm import Session

from edge.config import loading
from edge.core.errors import DataError, RequestError
from fleet.database.base import open_database
from fleet.database.tables import FleetRig
from fleet.machine.places import FleetMachine, FleetPlaces, places_of
from fleet.machine.rig_papers import HOME
from fleet.machine.rig_register import add_rig, remove_rig
from fleet.machine.setting_up import set_up
from fleet.numbers.series import head, lines
from fleet.numbers.victoria import Numbers
from fleet.settings import FleetSettings, load
from tests.support.broker import PATIENCE_S, Listener, needs_mosquitto, wait_for
from tests.support.victoria import Victoria, needs_victoria

pytestmark = needs_mosquitto
OWN = ("state", "availability", "drift", "reply", "event", "history/tick")


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[tuple[FleetPlaces, FleetMachine]]:
    """A fleet of which only the broker runs."""
    with FleetBroker(tmp_path) as broker:
        yield broker.places, broker.machine


def papers(places: FleetPlaces, name: str, folder: str = "") -> Path:
    """Add a rig, and unpack what it takes with it."""
    out = places.folder.parent / f"{folder or name}.tar.gz"
    assert add_rig(places, name, "north", "tent", out), "a broker runs"
    home = unpacked(out)
    # The broker reads its list some tenths of a second after it was asked to.
    with connected(places.read().ports.broker, context(home), f"probe-{home.name}") as probe:
        own = f"greenhouse/{name}/event"
        wait_for(lambda: answer(probe, own) != "Not authorized", f"the rights of {name}")
    return home


def test_a_rig_publishes_its_own_topics_and_those_of_no_other(
    fleet: tuple[FleetPlaces, FleetMachine],
) -> None:
    places, machine = fleet
    one = papers(places, "rig-1")
    papers(places, "rig-2")
    port = machine.ports.broker
    with (
        Listener(port, "greenhouse/#", context=fleets_context(places), name="fleet") as heard,
        connected(port, context(one), "greenhouse-rig-1") as rig,
    ):
        for topic in OWN:
            assert answer(rig, f"greenhouse/rig-1/{topic}") != "Not authorized", topic
        for topic in (*(f"greenhouse/rig-2/{topic}" for topic in OWN), "greenhouse/rig-1/set/mode", "other"):
            assert answer(rig, topic) == "Not authorized", topic
        wait_for(lambda: len(heard.heard) >= len(OWN), "the messages that are allowed")
        assert {message.topic for message in heard.heard} == {f"greenhouse/rig-1/{topic}" for topic in OWN}


def test_a_rig_hears_its_own_orders_and_no_other_ones(fleet: tuple[FleetPlaces, FleetMachine]) -> None:
    places, machine = fleet
    one = papers(places, "rig-1")
    papers(places, "rig-2")
    port = machine.ports.broker
    with (
        Listener(port, "#", context=context(one), name="greenhouse-rig-1") as rig,
        Listener(port, "greenhouse/#", context=fleets_context(places), name="fleet") as chief,
    ):
        chief.send("greenhouse/rig-2/set/temperature", "25")
        chief.send("greenhouse/rig-2/state", "{}")
        chief.send("greenhouse/rig-1/set/temperature", "26")
        wait_for(lambda: rig.heard, "the rig's own order")
        assert [message.topic for message in rig.heard] == ["greenhouse/rig-1/set/temperature"]


def test_who_has_no_certificate_of_the_fleet_is_nobody(fleet: tuple[FleetPlaces, FleetMachine]) -> None:
    places, machine = fleet
    stranger = ssl.create_default_context(cafile=str(places.authority))
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    client.tls_set_context(stranger)
    ended, entered = threading.Event(), threading.Event()
    client.on_disconnect = lambda *_: ended.set()
    client.on_connect = lambda client, data, flags, code, more: None if code.is_failure else entered.set()
    try:
        client.connect("localhost", machine.ports.broker)
        client.loop_start()
        assert ended.wait(PATIENCE_S)
    except (ssl.SSLError, ConnectionError):
        pass  # refused in the handshake
    finally:
        client.loop_stop()
    assert not entered.is_set()


def test_a_rig_that_is_removed_has_no_rights_from_then_on(fleet: tuple[FleetPlaces, FleetMachine]) -> None:
    places, machine = fleet
    port = machine.ports.broker
    old = papers(places, "rig-1")
    with connected(port, context(old), "rig-1-lane") as rig:
        assert answer(rig, "greenhouse/rig-1/state") != "Not authorized"
        assert remove_rig(places, "rig-1", erase=False) == ""
        wait_for(lambda: answer(rig, "greenhouse/rig-1/event") == "Not authorized", "the end of its rights")
    papers(places, "rig-1", "again")
    with connected(port, context(old), "rig-1-lane") as rig:  # a certificate of before is no other rig's
        assert answer(rig, "greenhouse/rig-1/event") == "Not authorized"
    with connected(port, context(places.folder.parent / "again"), "rig-1-lane") as rig:
        assert answer(rig, "greenhouse/rig-1/event") != "Not authorized"


@needs_victoria
def test_a_rig_is_erased_from_both_stores_or_it_is_said_what_is_left(
    fleet: tuple[FleetPlaces, FleetMachine], tmp_path: Path
) -> None:
    places, machine = fleet
    settings = load(places.settings)
    for name in ("rig-1", "rig-10"):
        papers(places, name)
    with pytest.raises(DataError, match=r"rig-1 has no rights any more, but .*numbers\.url.*again"):
        remove_rig(places, "rig-1", erase=True)
    assert rows(settings) == ["rig-1", "rig-10"]
    with Victoria(tmp_path, port=machine.ports.numbers):
        numbers, now = Numbers(settings.numbers), time.time()
        for name in ("rig-1", "rig-10"):
            numbers.store(lines(name, now, ((head("temp_air_c"), 21.5), (head("seq"), 1))))
        assert remove_rig(places, "rig-1", erase=True) == ""
        found = numbers.series('{rig=~".+"}', now - 60.0, now + 60.0)
        assert {series.labels["rig"] for series in found} == {"rig-10"}
        with pytest.raises(RequestError, match="rig-1 is no rig"):
            remove_rig(places, "rig-1", erase=True)
    assert rows(settings) == ["rig-10"]


def rows(settings: FleetSettings) -> list[str]:
    with Session(open_database(settings.database)) as session:
        return list(session.scalars(select(FleetRig.name).order_by(FleetRig.name)))


def test_what_the_broker_kept_of_a_rig_goes_with_it(fleet: tuple[FleetPlaces, FleetMachine]) -> None:
    places, machine = fleet
    port, home = machine.ports.broker, papers(places, "rig-1")
    with Listener(port, "$SYS/none", context=context(home), name="greenhouse-rig-1/x") as rig:
        rig.send("greenhouse/rig-1/state", "{}", retain=True)
    remove_rig(places, "rig-1", erase=False)
    with Listener(port, "greenhouse/#", context=fleets_context(places), name="fleet-1") as chief:
        chief.send("greenhouse/rig-1/set/status", "PRESS")
        wait_for(lambda: chief.heard, "the last message")
        assert [message.topic for message in chief.heard] == ["greenhouse/rig-1/set/status"]


def test_the_archive_holds_settings_that_the_daemon_takes(fleet: tuple[FleetPlaces, FleetMachine]) -> None:
    places, machine = fleet
    home = papers(places, "rig-1")
    text = (home / "mqtt.yaml").read_text()
    settings = loading.parse(text).mqtt
    assert (settings.host, settings.port, settings.rig) == ("localhost", machine.ports.broker, "rig-1")
    assert settings.client_key == f"{HOME}/rig.key"
    archive = home.with_name("rig-1.tar.gz")
    assert archive.stat().st_mode & 0o077 == 0
    assert "NAME" not in (home / "README.txt").read_text()
    assert yaml.safe_load((places.rigs / "rig-1.yaml").read_text())["kind"] == "tent"
    assert not list(places.folder.rglob("rig.key"))


@pytest.mark.parametrize(
    ("name", "group", "reason"),
    [
        ("fleet", "", "own name"),
        ("rig/2", "", "NAME: 'rig/2' does not match"),
        ("+", "", "does not match"),
        ("../../x", "", "does not match"),
        ("x" * 56, "", "does not match"),
        ("rig-1\nuser fleet", "", "does not match"),
        ("rig-1", "a b", "--group"),
    ],
)
def test_a_name_that_would_reach_further_is_refused(
    tmp_path: Path, name: str, group: str, reason: str
) -> None:
    places = places_of(tmp_path / "fleet")
    set_up(places, ["localhost"], True, lambda words: None)
    with pytest.raises(RequestError, match=reason):
        add_rig(places, name, group, "", tmp_path / "out.tar.gz")
    assert "user fleet\n" in places.rights.read_text()
    assert places.rights.read_text().count("user ") == 1


def test_a_rig_is_added_once_and_no_file_is_overwritten(tmp_path: Path) -> None:
    places = places_of(tmp_path / "fleet")
    set_up(places, ["localhost"], True, lambda words: None)
    assert not add_rig(places, "rig-1", "", "", tmp_path / "one.tar.gz")  # no broker runs
    with pytest.raises(RequestError, match="already"):
        add_rig(places, "rig-1", "", "", tmp_path / "two.tar.gz")
    with pytest.raises(RequestError, match="exists already"):
        add_rig(places, "rig-2", "", "", tmp_path / "one.tar.gz")
    with pytest.raises(RequestError, match="no rig of this fleet"):
        remove_rig(places, "rig-3", erase=False)
