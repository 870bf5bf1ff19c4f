"""The drift monitor's verdict on its topic, in Home Assistant, and on the page."""

import json

import pytest
from home_assistant import check_device

from edge.app.display import page
from edge.core.messages import Drift, DriftRow, DriftState
from edge.mqtt import discovery, states
from edge.mqtt.topics import Topics
from tests.support.mqtt_rig import ControlLoop, record, settings

CONFIGURED = settings()
SENSOR = discovery.device(CONFIGURED)["components"]["twin_disagrees"]
FOUND = Drift(
    DriftState.DISAGREES,
    text="the twin disagrees since 14:20, mostly with the fan on",
    since_utc=1.7e9,
    where="fan_on",
    error_k=0.42,
    evidence=1.02,
    learnt=1.0,
    regimes={"fan_on": DriftRow(12.0, 0.8, 0.42)},
)


def payload(drift: Drift | None):
    loop = ControlLoop()
    loop.last_record = record(drift=drift)
    return json.loads(json.dumps(states.drift(loop.status()), allow_nan=False))


def test_the_topic_tells_since_when_and_where():
    told = payload(FOUND)
    assert (told["state"], told["since_utc"], told["where"]) == ("disagrees", 1.7e9, "fan_on")
    assert told["regimes"] == {"fan_on": {"ticks": 12.0, "share_of_squares": 0.8, "error_k": 0.42}}


def test_numbers_that_json_has_not_are_null():
    assert payload(Drift(error_k=float("nan"), evidence=float("inf")))["error_k"] is None


@pytest.mark.parametrize(
    ("drift", "shown"),
    [
        (FOUND, "ON"),
        (Drift(DriftState.AGREES), "OFF"),
        (Drift(DriftState.UNKNOWN, reason="no twin runs"), "None"),  # unknown, as Home Assistant has it
        (None, "None"),
    ],
)
def test_home_assistant_has_a_sensor_that_is_on_while_it_disagrees(drift, shown):
    jinja2 = pytest.importorskip("jinja2")
    template = jinja2.Environment().from_string(SENSOR["value_template"])
    assert template.render(value_json=payload(drift)) == shown


def test_its_attributes_are_the_whole_topic():
    assert SENSOR["json_attributes_topic"] == SENSOR["state_topic"] == Topics.of(CONFIGURED.mqtt).drift
    check_device(discovery.device(CONFIGURED))


def test_the_page_shows_it():
    assert ("yellow", f"twin       {FOUND.text}") in page([record(drift=FOUND)], [], 100, 24)
    assert not any(text.startswith("twin") for _, text in page([record()], [], 100, 24))
