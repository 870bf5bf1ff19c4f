"""The fleet's page: who sees and orders what, in which group; what strangers and liars get."""

import io
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from bundles import Workshop
from fleet_pages import PASSWORD, STATE, TOKEN, FleetPageOfTest, fleet_page
from sqlalchemy.orm import Session

from edge.bundle.remote import fetch
from edge.page.access import Role
from edge.page.password_tries import TRIES
from fleet.database.base import open_database
from fleet.database.tables import ToldTwin
from fleet.rollout.archives import add_archive, archive_url
from fleet.settings import NumbersSettings
from tests.support.broker import free_port
from tests.support.page_process import Client, cookie_of

EVIL = '<img src=x onerror="alert(1)">'


@pytest.fixture
def page(tmp_path: Path) -> Iterator[FleetPageOfTest]:
    with fleet_page(tmp_path, numbers=NumbersSettings(url=f"http://127.0.0.1:{free_port()}")) as running:
        yield running


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    (tmp_path / "workshop").mkdir()
    return Workshop(tmp_path / "workshop")


def names(client: Client, query: str = "") -> list[str]:
    return [rig["name"] for rig in client.get(f"/api/rigs{query}").json()["rigs"]]


def test_rigs_are_listed_the_worst_first(page: FleetPageOfTest) -> None:
    page.add_rig("well")
    page.add_rig("away", is_online=False)
    page.add_rig("silent", last_utc=time.time() - 700.0)
    page.add_rig("hot", state=STATE | {"temp_air_c": 26.5})
    page.add_rig("tripped", state=STATE | {"tripped": 1, "trips": "over-temperature"})
    page.add_rig("blind", state=STATE | {"temp_air_c": None, "temp_air_quality": "stale"})
    page.add_rig("stopped", state=STATE | {"emergency_stop": 1})
    listing = page.client("Ann").get("/api/rigs").json()
    assert [(rig["name"], rig["standing"]) for rig in listing["rigs"]] == [
        ("away", "offline"),
        ("silent", "offline"),
        ("tripped", "tripped"),
        ("blind", "faulted"),
        ("stopped", "stopped"),
        ("hot", "off_reference"),
        ("well", "well"),
    ]
    why = {rig["name"]: rig["why"] for rig in listing["rigs"]}
    assert why["silent"] == "last heard 12 min ago"
    assert why["tripped"] == "tripped: over-temperature"
    assert why["blind"] == "no trustworthy air temperature: stale"
    assert why["hot"] == "air is +2.4 K off its reference"
    assert listing["counts"]["offline"] == 2
    assert listing["broker"] is False  # none is configured here


def test_rigs_are_found_by_group_kind_standing_and_name(page: FleetPageOfTest) -> None:
    for name, group, kind in (("a-1", "north", "tent"), ("a-2", "north", "case"), ("b-1", "south", "tent")):
        page.add_rig(name, group, kind)
    page.add_rig("b-2", "south", "tent", is_online=False)
    client = page.client("Ann")
    assert names(client, "?group=north") == ["a-1", "a-2"]
    assert names(client, "?kind=tent") == ["b-2", "a-1", "b-1"]
    assert names(client, "?standing=offline") == ["b-2"]
    assert names(client, "?search=NORTH+case") == ["a-2"]
    assert client.get("/api/rigs?standing=ill").status_code == 400


def test_nobody_sees_anything_without_a_session(page: FleetPageOfTest) -> None:
    page.add_rig("a-1", "north")
    nobody = page.client()
    for path in (
        "/api/me",
        "/api/rigs",
        "/api/rigs/a-1",
        "/api/rigs/a-1/course",
        "/api/alarms",
        "/api/sessions",
    ):
        assert nobody.get(path).status_code == 401, path
    assert nobody.post("/api/rigs/a-1/order", {"what": "mode", "payload": "off"}).status_code == 401
    assert nobody.get("/").ok  # the page itself, where one logs in


def test_a_rig_of_another_group_is_as_one_that_is_not_there(page: FleetPageOfTest) -> None:
    page.add_rig("a-1", "north")
    page.add_rig("b-1", "south")
    page.add_rig("c-1")  # of no group: only who may see all sees it
    ann = page.client("Ann", "north", Role.ADMIN)
    assert names(ann) == ["a-1"]
    assert ann.get("/api/rigs/a-1").json()["role"] == "admin"
    for other in ("b-1", "c-1", "never-was"):
        for found in (
            ann.get(f"/api/rigs/{other}"),
            ann.get(f"/api/rigs/{other}/course?from_utc=1&to_utc=2"),
            ann.post(f"/api/rigs/{other}/order", {"what": "emergency_stop", "payload": "PRESS"}),
        ):
            assert found.status_code == 404
            assert found.json()["error"] == "there is no such rig in your groups"
    listing = ann.get("/api/rigs?group=south").json()
    assert (listing["rigs"], listing["groups"]) == ([], ["north"])


def test_each_order_needs_its_role_in_the_rigs_own_group(page: FleetPageOfTest) -> None:
    page.add_rig("a-1", "north")
    page.add_rig("b-1", "south")
    ben = page.client("Ben", "north", Role.OPERATE)
    page.people.add("Ben", "south", Role.VIEW, None)
    order = {"what": "temperature", "payload": "25.5"}
    refused = ben.post("/api/rigs/b-1/order", order)
    assert (refused.status_code, refused.json()["error"]) == (
        403,
        "temperature needs the role operate, yours is view",
    )
    taken = ben.post("/api/rigs/a-1/order", order)  # no broker is configured, so it goes no further
    assert (taken.status_code, "mqtt.enabled" in taken.json()["error"]) == (503, True)
    assert ben.post("/api/rigs/a-1/order", {"what": "commission", "payload": "PRESS"}).status_code == 403
    for what, payload in (("temperature", "1e9"), ("temperature", "nan"), ("reboot", ""), ("mode", EVIL)):
        assert ben.post("/api/rigs/a-1/order", {"what": what, "payload": payload}).status_code == 400
    assert ben.post("/api/rigs/a-1/order", {"what": "ask", "payload": "x" * 2000}).status_code == 400


def test_a_right_that_is_taken_away_counts_at_once(page: FleetPageOfTest) -> None:
    page.add_rig("a-1", "north")
    ann = page.client("Ann", "north", Role.VIEW)
    assert names(ann) == ["a-1"]
    page.people.remove("Ann", "north")
    assert ann.get("/api/rigs").status_code == 401


def test_a_new_password_and_leaving_end_a_session(page: FleetPageOfTest) -> None:
    ann, ben = page.client("Ann"), page.client("Ben")
    page.people.add("Ann", "*", Role.ADMIN, "another good one")
    assert ann.get("/api/me").status_code == 401
    assert ann.post("/api/session", {"name": "Ann", "password": PASSWORD}).status_code == 401
    secret = cookie_of(ben).value
    assert ben.send("DELETE", "/api/session").ok
    assert ben.get("/api/me", cookie=f"greenhouse_session={secret}").status_code == 401


def test_only_an_admin_of_all_groups_sees_and_ends_sessions(page: FleetPageOfTest) -> None:
    ann = page.client("Ann", "north", Role.ADMIN)
    assert ann.get("/api/sessions").status_code == 403
    chief = page.client("Chief")
    found = {row["name"]: row["session"] for row in chief.get("/api/sessions").json()["sessions"]}
    assert ann.send("DELETE", f"/api/sessions/{found['Chief']}").status_code == 403
    assert chief.send("DELETE", f"/api/sessions/{10**30}").status_code == 400
    assert chief.send("DELETE", f"/api/sessions/{found['Ann']}").ok
    assert ann.get("/api/me").status_code == 401


def test_a_password_may_be_tried_a_few_times(page: FleetPageOfTest) -> None:
    page.people.add("Ann", "*", Role.VIEW, PASSWORD)
    client = page.client()
    tries = [client.post("/api/session", {"name": "Ann", "password": "wrong"}) for _ in range(TRIES + 1)]
    assert [found.status_code for found in tries] == [401] * TRIES + [429]
    right = {"name": "Ann", "password": PASSWORD}
    assert client.post("/api/session", right).status_code == 429
    # Behind caddy each browser has tries of its own: who guesses locks nobody else out.
    assert client.post("/api/session", right, x_forwarded_for="192.0.2.7").ok


def test_a_change_from_another_site_is_refused(page: FleetPageOfTest) -> None:
    page.add_rig("a-1")
    ann = page.client("Ann")
    order = {"what": "mode", "payload": "off"}
    assert ann.post("/api/rigs/a-1/order", order, origin="https://evil.example").status_code == 403
    assert ann.get("/api/rigs", host="evil.example").status_code == 421


def test_what_rigs_tell_is_never_html(page: FleetPageOfTest) -> None:
    page.add_rig(EVIL, kind=EVIL, state=STATE | {"tripped": 1, "trips": EVIL, "mode": {"a": EVIL}})
    ann = page.client("Ann")
    answer = ann.get("/api/rigs")
    assert answer.json()["rigs"][0]["name"] == EVIL
    assert answer.headers["content-type"] == "application/json"
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "default-src 'self'" in ann.get("/").headers["content-security-policy"]
    for name in ("rig", "rig_list", "alarms", "rollouts", "app"):
        script = ann.get(f"/fleet/{name}.js")
        assert script.ok
        assert "innerHTML" not in script.text


def alert(name: str, rig: str, ends: str = "2100-01-01T00:00:00Z", **annotations: str) -> dict[str, object]:
    labels = {"alertname": name, "rig": rig, "severity": "alarm"}
    return {"labels": labels, "annotations": annotations, "endsAt": ends, "generatorURL": "x"}


def test_alarms_begin_last_end_and_are_acknowledged_in_their_group(page: FleetPageOfTest) -> None:
    page.add_rig("a-1", "north")
    page.add_rig("b-1", "south")
    vmalert = page.client()
    word = {"authorization": f"Bearer {TOKEN}"}

    def post(*alerts: dict[str, object]) -> None:
        assert vmalert.post("/api/v2/alerts", list(alerts), **word).ok

    post(alert("rig_silent", "a-1", text="a-1 is silent"), alert("rig_silent", "b-1", text=EVIL))
    post(alert("rig_silent", "a-1", text="a-1 is silent"))
    ann, ben = page.client("Ann", "north", Role.OPERATE), page.client("Ben", "north", Role.VIEW)
    (found,) = ann.get("/api/alarms?lasting=1").json()["alarms"]
    assert (found["rig"], found["text"], found["ended_utc"]) == ("a-1", "a-1 is silent", None)
    assert ben.post(f"/api/alarms/{found['id']}/acknowledge").status_code == 403
    assert ann.post(f"/api/alarms/{found['id']}/acknowledge").ok
    other = next(
        row for row in page.client("Chief").get("/api/alarms").json()["alarms"] if row["rig"] == "b-1"
    )
    for hidden in (other["id"], 10**30):
        assert ann.post(f"/api/alarms/{hidden}/acknowledge").status_code == 404
    post(alert("rig_silent", "a-1", ends="2001-01-01T00:00:00.123456789Z"))
    assert ann.get("/api/alarms?lasting=1").json()["alarms"] == []
    (found,) = ann.get("/api/alarms").json()["alarms"]
    assert (found["seen_by"], found["ended_utc"] is None) == ("Ann", False)
    post(alert("rig_silent", "a-1"))
    assert len(ann.get("/api/alarms").json()["alarms"]) == 2


def test_alarms_come_from_vmalert_alone_and_are_checked(page: FleetPageOfTest) -> None:
    client = page.client()
    good = [alert("rig_silent", "a-1")]
    assert client.post("/api/v2/alerts", good).status_code == 401
    assert client.post("/api/v2/alerts", good, authorization="Bearer guess").status_code == 401
    word = {"authorization": f"Bearer {TOKEN}"}
    for bad, place in (
        ({}, "must be a list"),
        ([{}], "labels: missing"),
        ([alert("x", "a-1", ends="soon")], "'soon' is not a time"),
        ([alert("x", "a-1") | {"labels": {"rig": 1}}], "labels.rig"),
    ):
        refused = client.post("/api/v2/alerts", bad, **word)
        assert (refused.status_code, place in refused.json()["error"]) == (400, True), refused.text
    many = [alert("rig_silent", f"rig-{number}", text="x" * 100) for number in range(1000)]
    assert client.post("/api/v2/alerts", many, **word).ok  # far more than a browser may send
    assert len(page.client("Ann").get("/api/alarms").json()["alarms"]) == 200


def test_the_newest_twin_is_shown(page: FleetPageOfTest) -> None:
    page.add_rig("a-1", kind="tent")
    ann = page.client("Ann")
    assert ann.get("/api/rigs/a-1").json()["twin"] is None
    with Session(open_database(page.settings.database)) as session, session.begin():
        effects = {"wall_loss": {"UA": {"value": 5.1, "low": 4.8, "high": 5.4}}}
        session.add(ToldTwin(rig="a-1", bundle="b-7", utc=1.7e9, document={"effects": effects}))
    found = ann.get("/api/rigs/a-1").json()["twin"]
    assert found == {"bundle": "b-7", "utc": 1.7e9, "effects": effects}


def test_a_bundle_is_handed_to_any_rig_by_its_hash(page: FleetPageOfTest, workshop: Workshop) -> None:
    archive = workshop.archive("1.0")
    sha256 = add_archive(open_database(page.settings.database), archive, workshop.trusted, 1.0)
    into, place = io.BytesIO(), archive_url(f"{page.base}/bundles", sha256)
    fetch(place, sha256, into)
    assert into.getvalue() == archive.read_bytes()
    for name in (f"{'0' * 64}.zip", "x", f"{sha256}.zip.zip"):
        assert page.client().get(f"/bundles/{name}").status_code == 404


def test_numbers_that_cannot_be_read_are_an_error_with_its_place(page: FleetPageOfTest) -> None:
    page.add_rig("a-1")
    ann = page.client("Ann")
    now = time.time()
    away = ann.get(f"/api/rigs/a-1/course?from_utc={now - 86400}&to_utc={now}")
    assert away.status_code == 503
    assert "numbers.url" in away.json()["error"]
    assert ann.get(f"/api/rigs/a-1/course?from_utc={now}&to_utc={now - 1}").status_code == 400
