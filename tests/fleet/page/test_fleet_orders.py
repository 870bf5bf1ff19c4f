"""Orders through the fleet's page to a rig at a real broker: its own checks answer."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from fleet_pages import FleetPageOfTest, fleet_page
from sqlalchemy import select
from sqlalchemy.orm import Session

from edge.config.settings import MqttSettings
from edge.mqtt.telemetry import Telemetry
from edge.page.access import Role
from fleet.database.base import open_database
from fleet.database.tables import FleetOrder
from fleet.page import order_desk
from tests.support.broker import Broker, Listener, needs_mosquitto, wait_for
from tests.support.mqtt_rig import ControlLoop, MemoryOutbox, settings
from tests.support.page_process import Client

pytestmark = needs_mosquitto


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with Broker(tmp_path) as running:
        yield running


@pytest.fixture
def page(tmp_path: Path, broker: Broker) -> Iterator[FleetPageOfTest]:
    mqtt = MqttSettings(enabled=True, host="127.0.0.1", port=broker.port, rig="fleet")
    with fleet_page(tmp_path, mqtt=mqtt) as running:
        running.add_rig("rig-1", "north")
        running.add_rig("rig-2", "south")
        yield running


@pytest.fixture
def loop(broker: Broker, page: FleetPageOfTest) -> Iterator[ControlLoop]:
    """The rig `rig-1`: a real daemon's telemetry with a control loop in front."""
    control = ControlLoop()
    telemetry = Telemetry(settings(broker.port), control.ask, control.post, MemoryOutbox)
    try:
        client = page.client("Look")
        wait_for(lambda: client.get("/api/rigs").json()["broker"], "the page is at the broker")
        with Listener(broker.port, "greenhouse/rig-1/availability") as listener:
            wait_for(
                lambda: b"online" in listener.payloads("greenhouse/rig-1/availability"), "the rig is online"
            )
        # Online comes before the subscriptions are granted: an order that is answered proves them.
        wait_for(lambda: order(client, "status", "PRESS").ok, "the rig answers", 60.0)
        control.requests.clear()
        yield control
    finally:
        telemetry.close()


def order(client: Client, what: str, payload: object, rig: str = "rig-1"):  # type: ignore[no-untyped-def]
    return client.post(f"/api/rigs/{rig}/order", {"what": what, "payload": payload})


def test_an_operator_sets_the_reference_of_a_rig_of_their_group(
    page: FleetPageOfTest, loop: ControlLoop
) -> None:
    ann = page.client("Ann", "north", Role.OPERATE)
    taken = order(ann, "temperature", "26.5")
    assert (taken.status_code, taken.json()["ok"]) == (200, True)
    assert loop.operation.reference_c == 26.5
    with Session(open_database(page.settings.database)) as session:
        noted = session.scalars(select(FleetOrder).where(FleetOrder.what == "temperature")).one()
    assert (noted.rig, noted.person, noted.payload) == ("rig-1", "Ann", "26.5")
    assert json.loads(noted.answer or "")["ok"] is True


def test_the_rigs_own_limits_decide(page: FleetPageOfTest, loop: ControlLoop) -> None:
    ann = page.client("Ann", "north", Role.OPERATE)
    refused = order(ann, "temperature", "39.5")  # allowed to some rig, not to this one: 15 to 38
    assert (refused.status_code, refused.json()["ok"]) == (400, False)
    assert "38" in refused.json()["error"]
    assert loop.operation.reference_c is None


def test_a_viewer_stops_a_rig_and_does_nothing_else(page: FleetPageOfTest, loop: ControlLoop) -> None:
    ben = page.client("Ben", "north", Role.VIEW)
    assert order(ben, "mode", "off").status_code == 403
    assert order(ben, "emergency_stop", "OFF").status_code == 403  # which releases it
    assert order(ben, "emergency_stop", "PRESS").status_code == 200
    assert loop.operation.emergency_stop


def test_an_order_to_another_group_leaves_nothing_at_the_broker(
    page: FleetPageOfTest, broker: Broker
) -> None:
    ann = page.client("Ann", "south", Role.ADMIN)
    with Listener(broker.port, "greenhouse/+/set/#") as listener:
        for rig in ("rig-1", "rig-1/set/mode", "+", "#"):
            assert order(ann, "mode", "off", rig.replace("#", "%23").replace("/", "%2F")).status_code in (
                404,
                405,
            )
        listener.send("greenhouse/rig-9/set/mode", "end")
        wait_for(lambda: listener.heard, "the last message")
        assert [message.topic for message in listener.heard] == ["greenhouse/rig-9/set/mode"]


def test_a_rig_that_does_not_answer_is_said_to(
    page: FleetPageOfTest, broker: Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(order_desk, "ANSWER_MAX_S", 0.3)
    ann = page.client("Ann")
    wait_for(lambda: ann.get("/api/rigs").json()["broker"], "the page is at the broker")
    silent = order(ann, "mode", "off", "rig-2")
    assert (silent.status_code, "no answer" in silent.json()["error"]) == (504, True)
    with Session(open_database(page.settings.database)) as session:
        assert "no answer" in (session.scalars(select(FleetOrder)).one().answer or "")


def test_what_a_rig_says_of_its_twin_is_shown(page: FleetPageOfTest, broker: Broker) -> None:
    ann = page.client("Ann")
    with Listener(broker.port) as listener:
        wait_for(lambda: ann.get("/api/rigs").json()["broker"], "the page is at the broker")
        listener.send("greenhouse/rig-1/drift", b"{not json")
        listener.send(
            "greenhouse/rig-1/drift", json.dumps({"state": "disagrees", "text": "<b>lid open?</b>"})
        )
        wait_for(lambda: ann.get("/api/rigs/rig-1").json()["standing"] == "drift", "the drift is shown")
        assert ann.get("/api/rigs/rig-1").json()["why"] == "<b>lid open?</b>"
