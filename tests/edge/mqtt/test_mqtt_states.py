"""Live values, drift and twin on their topics."""

import json
import math
from dataclasses import replace

import pytest
from home_assistant import check_device

from edge.app.display import page
from edge.core.messages import (
    Drift,
    DriftRow,
    DriftState,
    Echo,
    Forecast,
    ForecastSkill,
    Reading,
    ReadingQuality,
)
from edge.formats.tick_json import echo_json
from edge.mqtt import discovery, states
from edge.mqtt.topics import Topics
from edge.tick.orders import FanMode, Mode
from tests.support.mqtt_rig import ControlLoop, record, settings


def state(loop: ControlLoop, **counters):
    return states.state(loop.status(), counters)


def test_a_quiet_tick_is_shown_as_it_is():
    shown = state(ControlLoop(), outbox_depth=7)
    expected = {
        "seq": 1,
        "temp_air_c": 24.5,
        "reference_c": 26.0,
        "hvac_mode": "auto",
        "action": "heating",
        "heater_duty": 0.35,
        "fan_on": 0,
        "link_up": 1,
        "tripped": 0,
        "problem": 0,
        "outbox_depth": 7,
    }
    assert {key: shown[key] for key in expected} == expected


@pytest.mark.parametrize(
    "quality", [quality for quality in ReadingQuality if quality is not ReadingQuality.GOOD]
)
def test_a_reading_that_is_not_good_is_null_and_a_problem(quality):
    loop = ControlLoop()
    loop.last_record = record(readings={"temp_air": Reading("temp_air", 24.5, 0.0, quality)})
    shown = state(loop)
    assert shown["temp_air_c"] is None
    assert shown["temp_air_quality"] == quality.value
    assert shown["problem"] == 1


@pytest.mark.parametrize("value", [None, math.nan, math.inf, -math.inf])
def test_no_number_is_null_and_never_breaks_the_json(value):
    loop = ControlLoop()
    loop.last_record = record(temp_air=value, late_s=math.nan, reference_c=math.nan)
    shown = state(loop)
    assert shown["temp_air_c"] is None
    assert shown["reference_c"] is None
    json.dumps(shown, allow_nan=False)


def test_a_sensor_the_board_does_not_have_is_null():
    shown = state(ControlLoop())
    assert (shown["co2_ppm"], shown["co2_quality"]) == (None, "absent")


def test_without_a_word_of_the_board_nothing_is_claimed_about_its_outputs():
    loop = ControlLoop()
    loop.last_record = record(echo=None)
    shown = state(loop)
    assert [shown[key] for key in ("heater_duty", "fan_on", "led", "valve_open", "action")] == [None] * 5
    assert shown["problem"] == 1


@pytest.mark.parametrize(
    ("heater_duty", "fan_on", "mode", "action"),
    [
        (0.05, False, Mode.AUTO, "heating"),
        (0.05, True, Mode.AUTO, "heating"),
        (0.0, True, Mode.AUTO, "fan"),
        (0.0, False, Mode.AUTO, "idle"),
        (0.0, False, Mode.OFF, "off"),
        (0.0, True, Mode.OFF, "fan"),
    ],
)
def test_the_action_is_what_the_board_drives(heater_duty, fan_on, mode, action):
    loop = ControlLoop()
    loop.operation = replace(loop.operation, mode=mode)
    loop.last_record = record(echo=Echo(heater_duty, fan_on, 0.0, False, False, "", 0.0))
    assert state(loop)["action"] == action


@pytest.mark.parametrize(
    ("mode", "stop", "shown"),
    [
        (Mode.AUTO, False, "auto"),
        (Mode.HEAT, False, "heat"),
        (Mode.FAN_ONLY, False, "fan_only"),
        (Mode.OFF, False, "off"),
        (Mode.MANUAL, False, None),
        (Mode.AUTO, True, "off"),
        (Mode.MANUAL, True, "off"),
    ],
)
def test_home_assistant_is_given_modes_it_knows(mode, stop, shown):
    loop = ControlLoop()
    loop.operation = replace(loop.operation, mode=mode, emergency_stop=stop)
    assert state(loop)["hvac_mode"] == shown


def test_an_order_shows_before_the_next_tick():
    loop = ControlLoop()
    loop.operation = replace(
        loop.operation, reference_c=30.0, controller="MPC-P", fan_mode=FanMode.ON, mode=Mode.HEAT
    )
    shown = state(loop)
    assert (shown["reference_c"], shown["controller"]) == (30.0, "MPC-P")
    assert (shown["fan_mode"], shown["hvac_mode"]) == ("on", "heat")


@pytest.mark.parametrize(("until_s", "shown"), [(None, 0), (-1.0, 0), (0.0, 0), (1.0, 1)])
def test_maintenance_ends_by_itself(until_s, shown):
    loop = ControlLoop()
    until = None if until_s is None else loop.last_record.utc + until_s
    loop.operation = replace(loop.operation, maintenance_until_utc=until)
    assert state(loop)["maintenance"] == shown


def test_trips_of_the_daemon_and_of_the_board_are_both_told():
    loop = ControlLoop()
    loop.trips = ("over_temperature",)
    loop.last_record = record(echo=Echo(0.0, True, 0.0, False, True, "sensor_fault", 0.0))
    shown = state(loop)
    assert shown["trips"] == "over_temperature, sensor_fault"
    assert (shown["tripped"], shown["problem"]) == (1, 1)


def test_the_forecast_says_which_times_it_is_for():
    shown = states.forecast(ControlLoop().status())
    assert shown == {"seq": 1, "utc": 1.7e9, "step_s": 60.0, "reference_c": 26.0, "forecast_c": [24.9, 25.3]}


def test_the_decision_carries_its_why():
    shown = states.decision(ControlLoop().status())
    assert shown["why"] == {"solve_ms": 1.5}
    assert shown["sent"]["heater_duty"] == shown["wanted"]["heater_duty"] == 0.35


def test_counters_of_the_line_are_told_and_unknown_where_there_is_no_line():
    status = ControlLoop().status()
    assert states.state(status, {})["line_bad_crc"] is None
    shown = states.state({**status, "line": {"bad_crc": 3}}, {})
    assert (shown["line_bad_crc"], shown["line_retries"]) == (3, 0)


def test_the_outputs_are_those_of_now_and_not_of_the_last_tick():
    loop = ControlLoop()
    assert loop.last_record.echo.heater_duty > 0.0
    after_stop = {**loop.status(), "echo": echo_json(Echo(0.0, False, 0.0, False, False, "", 101.0))}
    shown = states.state(after_stop, {})
    assert (shown["heater_duty"], shown["action"]) == (0.0, "idle")


def test_each_predictor_says_what_it_expects_or_why_it_does_not():
    loop = ControlLoop()
    told = Forecast({1: 24.512, 60: 26.0}, {60: 0.75}, outside=True)
    loop.last_record = record(forecasts={"arx": told, "ham": Forecast(reason="2 of 10 rows of history")})
    assert states.forecasts(loop.status()) == {
        "seq": 1,
        "utc": 1.7e9,
        "step_s": 60.0,
        "forecasts": {
            "arx": {
                "temp_c": {"1": 24.51, "60": 26.0},
                "half_width_k": {"60": 0.75},
                "outside": 1,
                "reason": "",
            },
            "ham": {"temp_c": {}, "half_width_k": {}, "outside": None, "reason": "2 of 10 rows of history"},
        },
    }


def test_skill_is_told_by_predictor_and_horizon():
    loop = ControlLoop()
    loop.last_record = record(
        skill=(
            ForecastSkill("arx", "v1", 15, 7, 0.2, 0.9, 0.99, 0.5, 0.91),
            ForecastSkill("arx", "v1", 60, 7, 0.4, None, None, None, None),
        )
    )
    shown = states.skill(loop.status())
    of_arx = shown["predictors"]["arx"]
    assert of_arx["version"] == "v1"
    assert of_arx["horizons"]["15"] == {
        "scored": 7,
        "mae_k": 0.2,
        "against_persistence": 0.9,
        "against_pbm": 0.99,
        "half_width_k": 0.5,
        "covered": 0.91,
    }
    assert of_arx["horizons"]["60"]["against_pbm"] is None


def test_before_anything_was_scored_the_skill_is_empty():
    assert states.skill(ControlLoop().status()) == {"seq": 1, "utc": 1.7e9, "predictors": {}}


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
