"""Sites of a fleet: what their one certificate may do, what their papers hold, and what is refused."""

import re
from functools import partial
from pathlib import Path

import pytest
from fleet_broker import FleetBroker, answer, connected, context, fleets_context, unpacked
from sqlalchemy import select
from sqlalchemy.orm import Session

from edge.__main__ import main
from edge.config import loading
from edge.core.errors import RequestError
from fleet.database.base import open_database
from fleet.database.tables import FleetRig
from fleet.machine import rig_register
from fleet.machine.places import FleetPlaces, places_of
from fleet.machine.rig_papers import read_papers
from fleet.machine.rig_register import add_rig, add_to_site, read_sites, remove_rig, remove_site
from fleet.machine.setting_up import set_up
from fleet.settings import load
from tests.support.broker import Listener, needs_mosquitto, wait_for

REFUSED = "Not authorized"
OWN = ("state", "availability", "reply", "event", "history/tick")
RIGS = ["tent-1", "tent-2"]


@pytest.fixture
def places(tmp_path: Path) -> FleetPlaces:
    """A fleet of which nothing runs."""
    found = places_of(tmp_path / "fleet")
    set_up(found, ["localhost"], True, lambda words: None)
    return found


def add(places: FleetPlaces, name: str, rigs: list[str], archive: str = "") -> Path:
    """Add a site, or rigs to it; return its unpacked papers."""
    out = places.folder.parent / f"{archive or name}.tar.gz"
    add_to_site(places, name, rigs, "north", "tent", out)
    return unpacked(out)


def bridged(home: Path) -> set[str]:
    """Return the lines of a bridge's topics."""
    return {line for line in (home / "bridge.conf").read_text().splitlines() if line.startswith("topic ")}


@needs_mosquitto
def test_a_sites_certificate_has_the_rights_of_its_rigs_and_no_others(tmp_path: Path) -> None:
    with FleetBroker(tmp_path) as fleet:
        places, port = fleet.places, fleet.machine.ports.broker
        site = context(add(places, "school", RIGS), "site")
        add(places, "lab", ["tent-3"])
        add_rig(places, "tent-4", "", "", tmp_path / "tent-4.tar.gz")
        with (
            connected(port, site, "school") as bridge,
            Listener(port, "#", context=site, name="school-2") as heard,
            Listener(port, "none", context=fleets_context(places), name="chief") as chief,
        ):
            for rig in RIGS:  # the broker reads its list some tenths of a second after it was asked to
                wait_for(lambda rig=rig: answer(bridge, f"greenhouse/{rig}/event") != REFUSED, rig)
                for topic in OWN:
                    assert answer(bridge, f"greenhouse/{rig}/{topic}") != REFUSED, topic
                assert answer(bridge, f"greenhouse/{rig}/set/mode") == REFUSED
            for topic in OWN:
                for rig in ("tent-3", "tent-4", "tent-5"):
                    assert answer(bridge, f"greenhouse/{rig}/{topic}") == REFUSED, (rig, topic)
            for rig in ("tent-3", "tent-4", *RIGS):
                chief.send(f"greenhouse/{rig}/set/status", "PRESS")
                chief.send(f"greenhouse/{rig}/state", "{}")
            wait_for(lambda: len(heard.heard) >= len(RIGS), "the orders to its rigs")
            assert {message.topic for message in heard.heard} == {
                f"greenhouse/{rig}/set/status" for rig in RIGS
            }


@needs_mosquitto
def test_a_site_that_is_removed_has_no_rights_from_then_on(tmp_path: Path) -> None:
    with FleetBroker(tmp_path) as fleet:
        places, port = fleet.places, fleet.machine.ports.broker
        site = context(add(places, "school", RIGS), "site")
        with (
            connected(port, site, "school") as bridge,
            Listener(port, "greenhouse/#", context=fleets_context(places), name="chief") as chief,
        ):
            heard: list[str] = []
            bridge.on_message = lambda client, data, message: heard.append(message.topic)
            bridge.subscribe([(f"greenhouse/{rig}/set/+", 1) for rig in RIGS])
            wait_for(lambda: answer(bridge, "greenhouse/tent-2/event") != REFUSED, "its rights")
            chief.send("greenhouse/tent-2/set/status", "PRESS")
            wait_for(lambda: heard == ["greenhouse/tent-2/set/status"], "an order")
            remove_rig(places, "tent-1", erase=False)
            wait_for(lambda: answer(bridge, "greenhouse/tent-1/event") == REFUSED, "the end of one rig's")
            assert [paper.name for paper in read_sites(places)["school"]] == ["tent-2"]
            assert answer(bridge, "greenhouse/tent-2/event") != REFUSED
            assert remove_site(places, "school") == (["tent-2"], "")
            wait_for(lambda: answer(bridge, "greenhouse/tent-2/event") == REFUSED, "the end of all rights")
            chief.send("greenhouse/tent-2/set/status", "PRESS")
            answer(bridge, "greenhouse/tent-2/event")  # comes after all that was on its way
            assert heard == ["greenhouse/tent-2/set/status"]
            add(places, "school", ["tent-2"], "again")
            assert answer(bridge, "greenhouse/tent-2/event") == REFUSED  # papers of before are no later ones


def test_the_rigs_of_a_site_are_rigs_of_the_fleet(places: FleetPlaces) -> None:
    home = add(places, "school", RIGS)
    assert {path.name for path in home.iterdir()} == {
        *("README.txt", "bridge.conf", "bundle.yaml", "ca.crt", "site.crt", "site.key"),
    }
    assert home.with_name("school.tar.gz").stat().st_mode & 0o077 == 0
    assert not list(places.folder.rglob("site.key"))
    assert not re.search(r"NAME|\{|\}", (home / "README.txt").read_text())
    assert loading.parse((home / "bundle.yaml").read_text()).bundle.source_ca.endswith("ca.crt")
    with Session(open_database(load(places.settings).database)) as session:
        rows = session.execute(select(FleetRig.name, FleetRig.group, FleetRig.kind).order_by(FleetRig.name))
        assert rows.all() == [("tent-1", "north", "tent"), ("tent-2", "north", "tent")]


def test_the_bridge_carries_what_the_certificate_may_write_and_orders(places: FleetPlaces) -> None:
    home = add(places, "school", RIGS)
    own = places.rights.read_text().partition("user school")[2]
    rights = re.findall(r"^topic (write|read) (\S+)$", own, re.M)
    written = {f"topic {topic} out 1" for way, topic in rights if way == "write"}
    orders = {f"topic {topic} in 1" for way, topic in rights if way == "read" and "/set/" in topic}
    assert len(written) > 2 * len(OWN) and len(orders) == len(RIGS)
    assert bridged(home) == written | orders


def test_a_rig_comes_to_a_site_later_by_the_same_certificate(places: FleetPlaces) -> None:
    first = add(places, "school", RIGS)
    later = add(places, "school", ["tent-3"], "later")
    assert {path.name for path in later.iterdir()} == {"README.txt", "bridge.conf", "bundle.yaml", "ca.crt"}
    assert "not in this archive" in (later / "README.txt").read_text()
    assert bridged(later) > bridged(first)
    assert len({paper.common_name for paper in read_papers(places)}) == 1


@pytest.mark.parametrize(
    ("name", "rigs", "reason"),
    [
        ("school", ["lone"], "lone is a rig of this fleet already"),
        ("school", ["tent-1"], "tent-1 is a rig of this fleet of the site lab already"),
        ("lab", ["tent-2", "tent-1"], "tent-1 is a rig of this fleet of the site lab already"),
        ("school", ["tent-2", "tent-3", "tent-2"], "--rigs: tent-2 stands there twice"),
        ("school", ["tent-2", "+"], r"--rigs: '\+' does not match"),
        ("school", ["fleet"], "--rigs: 'fleet' is the fleet's own name"),
        ("sch/ool", ["tent-2"], "NAME: 'sch/ool' does not match"),
        ("school\nconnection x", ["tent-2"], "NAME: .* does not match"),
        ("fleet", ["tent-2"], "NAME: 'fleet' is the fleet's own name"),
    ],
)
def test_what_is_refused_changes_nothing(
    places: FleetPlaces, tmp_path: Path, name: str, rigs: list[str], reason: str
) -> None:
    add_rig(places, "lone", "", "", tmp_path / "lone.tar.gz")
    add(places, "lab", ["tent-1"])
    before = places.rights.read_text(), sorted(tmp_path.iterdir())
    with pytest.raises(RequestError, match=reason):
        add_to_site(places, name, rigs, "", "", tmp_path / "out.tar.gz")
    assert (places.rights.read_text(), sorted(tmp_path.iterdir())) == before
    assert sorted(paper.name for paper in read_papers(places)) == ["lone", "tent-1"]


def test_a_rig_of_a_site_gets_no_papers_of_its_own(places: FleetPlaces, tmp_path: Path) -> None:
    add(places, "lab", ["tent-1"])
    with pytest.raises(RequestError, match="of the site lab already; remove it first"):
        add_rig(places, "tent-1", "", "", tmp_path / "out.tar.gz")
    with pytest.raises(RequestError, match="school is no site of this fleet"):
        remove_site(places, "school")


def test_sites_by_the_command(
    places: FleetPlaces,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def call(*words: str) -> str:
        every = ["fleet", *words, "--folder", str(places.folder)]
        monkeypatch.setattr("sys.argv", ["greenhouse", *every])
        assert main(every) == 0
        return capsys.readouterr().out

    monkeypatch.chdir(tmp_path)
    said = call("site", "add", "school", "--rigs", *RIGS, "--kind", "tent")
    assert "school.tar.gz: bring it to the site's broker" in said and "secret key" in said
    assert "no broker runs" in said
    assert "holds no key" in call("site", "add", "school", "--rigs", "tent-3", "--out", "later.tar.gz")
    assert call("site", "list").split() == ["school", *RIGS, "tent-3"]
    assert call("rig", "list").splitlines()[0].split() == ["tent-1", "-", "tent", "school"]
    monkeypatch.setattr(rig_register, "remove_retained", partial(rig_register.remove_retained, timeout_s=0.2))
    removed = call("site", "remove", "school")
    assert "what the broker has kept of tent-1, tent-2, tent-3 stays there" in removed
    assert call("site", "list") == call("rig", "list") == ""
    assert "school" not in places.rights.read_text()
