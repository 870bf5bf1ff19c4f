"""edge/safety/supervisor.py, rules.py, memory.py: edges, what is no number, and any input at all."""

import json
import math
from dataclasses import astuple, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safety_cases import (
    FULL,
    NOT_NUMBERS,
    NOW,
    UTC,
    echo,
    judge,
    only_change,
    reading,
    rules,
    view,
)

from edge.config.settings import SafetySettings
from edge.core.errors import DataError, RequestError
from edge.core.messages import Command, Reading, ReadingQuality, Severity
from edge.safety.box_bounds import PAPER_BOX, paper_box, unknown_box
from edge.safety.memory import DAY_S, AirDoubt, AirRise, Dose, book_heat, heat_wh, survives_as, water_s
from edge.safety.relay_proof import EVERY_S, RelayProof
from edge.safety.rules import duty_below_trip, energy_duty
from edge.safety.supervisor import (
    SafetyMemory,
    clear_trip,
    follow_calibration,
    planning_limits,
    supervise,
)
from edge.safety.thermal_supervision import ThermalMemory
from edge.state.codecs import decode_safety, encode_safety

pytestmark = pytest.mark.slow

LIMITS = SafetySettings()
HEAT = Command(heater_duty=1.0)
FAN = Command(fan_on=True)
WATER = Command(valve_pulse_s=2.0)


def test_what_is_safe_is_sent_as_it_was_wanted():
    wanted = Command(heater_duty=0.55, fan_on=True, led=0.37, valve_pulse_s=1.3)
    verdict = judge(wanted)
    assert verdict.sent == wanted
    assert verdict.changes == () and verdict.events == ()
    assert not verdict.open_cutoff


def test_nothing_wanted_is_nothing_sent_without_a_reason_even_in_a_bad_world():
    verdict = judge(Command(), view(air=None, soil=None, tank=None, link_up=False))
    assert verdict.sent == Command()
    assert verdict.changes == ()


# Numbers


@pytest.mark.parametrize("wanted", [math.nan, math.inf, -math.inf, None, "full", -0.05, -1e-9])
def test_a_duty_that_is_no_number_from_0_up_is_off(wanted):
    verdict = judge(Command(heater_duty=wanted))
    assert verdict.sent.heater_duty == 0.0
    change = only_change(verdict, "heater_duty")
    assert (change.rule, change.sent) == ("heater.not_a_number", 0.0)


@pytest.mark.parametrize("wanted", [math.nan, math.inf, -math.inf, None, "on", -1.0])
def test_led_fan_and_valve_that_are_no_numbers_are_off(wanted):
    verdict = judge(Command(fan_on=wanted, led=wanted, valve_pulse_s=wanted))
    assert verdict.sent == Command()
    assert {change.rule for change in verdict.changes} == {
        "fan.not_a_number", "led.not_a_number", "valve.not_a_number",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("wanted", "sent", "rule"),
    [
        (0.0, 0.0, []),
        (0.05, 0.05, []),
        (0.049, 0.0, ["heater.step"]),
        (0.3 + 1e-12, 0.3, []),
        (6 * 0.05, 0.3, []),  # 0.30000000000000004
        (0.1 + 0.2 - 1e-12, 0.3, []),
        (0.299, 0.25, ["heater.step"]),
        (0.999, 0.95, ["heater.step"]),
        (1.0, 1.0, []),
        (1.05, 1.0, ["heater.range"]),
        (20.0, 1.0, ["heater.range"]),
    ],
)
def test_a_duty_is_cut_down_to_steps_of_a_twentieth(wanted, sent, rule):
    verdict = judge(Command(heater_duty=wanted))
    assert verdict.sent.heater_duty == sent
    assert rules(verdict, "heater_duty") == rule


@pytest.mark.parametrize(
    ("wanted", "sent"), [(0.0, 0.0), (0.37, 0.37), (0.379, 0.37), (1.0, 1.0), (1.01, 1.0)]
)
def test_led_moves_in_hundredths(wanted, sent):
    assert judge(Command(led=wanted)).sent.led == sent


@pytest.mark.parametrize(
    ("wanted", "on"), [(True, True), (False, False), (1, True), (0, False), (0.5, True), (2.0, True)]
)
def test_a_fan_is_on_or_off(wanted, on):
    assert judge(Command(fan_on=wanted)).sent.fan_on is on


# Heater needs a fresh good air temperature


@pytest.mark.parametrize("value", NOT_NUMBERS)
def test_no_number_means_no_heat(value):
    verdict = judge(HEAT, view(air=value))
    assert verdict.sent.heater_duty == 0.0
    assert only_change(verdict, "heater_duty").rule == "heater.air_unknown"


@pytest.mark.parametrize(
    "quality", [quality for quality in ReadingQuality if quality is not ReadingQuality.GOOD]
)
def test_a_reading_that_is_not_good_means_no_heat(quality):
    seen = view(air=reading("temp_air", 20.0, quality=quality))
    assert rules(judge(HEAT, seen), "heater_duty") == ["heater.air_unknown"]


@pytest.mark.parametrize(
    ("age_s", "duty"),
    [(0.0, 1.0), (9.99, 1.0), (10.0, 1.0), (10.01, 0.0), (1e9, 0.0), (-0.5, 1.0), (-0.51, 0.0),
     (math.nan, 0.0), (math.inf, 0.0), (-math.inf, 0.0)],
)  # fmt: skip
def test_an_old_reading_means_no_heat(age_s, duty):
    assert judge(HEAT, view(air=reading("temp_air", 20.0, age_s))).sent.heater_duty == duty


def test_a_box_without_a_reading_means_no_heat():
    assert judge(HEAT, replace(view(), readings={})).sent.heater_duty == 0.0


def test_without_an_air_temperature_the_fan_is_as_wanted():
    assert judge(FAN, view(air=None)).sent.fan_on is True
    assert judge(Command(), view(air=None)).sent.fan_on is False


# Over-temperature


@pytest.mark.parametrize(
    ("air", "hot"),
    [(39.9, False), (39.99999, False), (40.0, True), (40.00001, True), (42.9, True), (-30.0, False)],
)
def test_at_the_limit_the_heater_goes_off_and_the_fan_on(air, hot):
    verdict = judge(FULL, view(air=air))
    assert verdict.sent.heater_duty == (0.0 if hot else 1.0)
    assert verdict.sent.fan_on is hot
    assert verdict.sent.led == (0.0 if hot else 1.0)
    assert verdict.memory.trips == ()
    if hot:
        assert rules(verdict, "heater_duty") == ["heater.over_temperature"]
        assert rules(verdict, "fan_on") == ["fan.over_temperature"]
        assert rules(verdict, "led") == ["led.over_temperature"]
        assert only_change(verdict, "heater_duty").reason == f"air {air:.1f} °C, limit 40 °C"


@pytest.mark.parametrize(
    ("air", "trips"), [(42.99999, ()), (43.0, ("over_temperature",)), (79.0, ("over_temperature",))]
)
def test_at_the_trip_it_latches(air, trips):
    verdict = judge(FULL, view(air=air))
    assert verdict.memory.trips == trips
    assert [event.key for event in verdict.events] == [f"safety.{trip}" for trip in trips]
    assert all(event.severity is Severity.ALARM for event in verdict.events)
    assert verdict.open_cutoff is bool(trips)


def test_a_latched_trip_outlasts_its_cause_and_is_told_once():
    hot = judge(FULL, view(air=43.0))
    later = judge(FULL, view(air=22.0), hot.memory)
    assert later.sent == Command(fan_on=True, valve_pulse_s=2.0)
    assert later.memory.trips == ("over_temperature",)
    assert later.events == () and later.open_cutoff
    assert rules(later, "heater_duty") == ["heater.tripped"]
    assert rules(later, "fan_on") == ["fan.tripped"]
    assert rules(later, "led") == ["led.tripped"]
    again = judge(FULL, view(air=50.0), later.memory)
    assert again.memory.trips == ("over_temperature",) and again.events == ()


@pytest.mark.parametrize("trip", ["heater_no_effect", "sensor_offset", "one of a later version"])
def test_a_trip_that_is_not_hot_takes_only_the_heat(trip):
    verdict = judge(FULL, memory=SafetyMemory(trips=(trip,)))
    assert verdict.sent == replace(FULL, heater_duty=0.0)
    assert not verdict.open_cutoff


def test_where_a_fan_does_not_cool_the_cutoff_opens_for_the_heater_may_be_stuck_on():
    verdict = judge(FULL, memory=SafetyMemory(trips=("fan_no_effect",)))
    assert verdict.sent == replace(FULL, heater_duty=0.0)
    assert verdict.open_cutoff


def test_a_proof_of_the_relay_holds_heat_and_fan_back():
    running = RelayProof(since_s=1.0, running_s=0.0)
    memory = SafetyMemory(time_s=NOW - 60.0, thermal=ThermalMemory(proof=running))
    verdict = judge(Command(heater_duty=1.0, fan_on=True, led=0.5), memory=memory)
    assert verdict.sent == Command(led=0.5)
    assert rules(verdict, "heater_duty") == ["heater.relay_proof"]
    assert rules(verdict, "fan_on") == ["fan.relay_proof"]
    assert planning_limits(memory, LIMITS, NOW, 60.0).heater_max_duty == 0.0


def test_a_stuck_relay_is_answered_with_fan_and_cutoff():
    verdict = judge(FULL, memory=SafetyMemory(trips=("heater_stuck_on",)))
    assert (verdict.sent.heater_duty, verdict.sent.fan_on, verdict.open_cutoff) == (0.0, True, True)


@pytest.mark.parametrize(("air", "clears"), [(39.99, True), (40.0, False), (None, False), (math.nan, False)])
def test_a_trip_is_cleared_only_when_its_cause_is_gone(air, clears):
    memory = SafetyMemory(trips=("over_temperature", "fan_no_effect"))
    if clears:
        assert clear_trip(memory, LIMITS, air).trips == ()
    else:
        with pytest.raises(RequestError, match="the air is"):
            clear_trip(memory, LIMITS, air)


def test_a_high_trip_is_cleared_only_below_the_limit_of_the_air():
    limits, memory = SafetySettings(temp_trip_c=50.0), SafetyMemory(trips=("over_temperature",))
    assert clear_trip(memory, limits, 39.99).trips == ()
    with pytest.raises(RequestError, match="below 40 °C"):
        clear_trip(memory, limits, 40.0)


@pytest.mark.parametrize(("air", "clears"), [(38.49, True), (38.5, False)])
def test_a_low_trip_is_cleared_3_k_below_it(air, clears):
    limits = SafetySettings(temp_trip_c=41.5)
    memory = SafetyMemory(trips=("over_temperature",))
    if clears:
        assert clear_trip(memory, limits, air).trips == ()
    else:
        with pytest.raises(RequestError):
            clear_trip(memory, limits, air)


def test_clearing_nothing_needs_no_air():
    assert clear_trip(SafetyMemory(), LIMITS, None) == SafetyMemory()


# Link, board, emergency stop, maintenance


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"emergency_stop": True}, "emergency_stop"),
        ({"maintenance": True}, "maintenance"),
        ({"link_up": False}, "link_down"),
    ],
)
def test_all_is_off(change, rule):
    held_on = SafetyMemory(sent=FAN, fan_since_s=NOW - 1.0, time_s=NOW - 60.0)
    verdict = judge(replace(FULL, fan_on=True), view(air=41.0, **change), held_on)
    assert verdict.sent == Command()
    for actuator, name in (
        ("heater_duty", "heater"),
        ("fan_on", "fan"),
        ("led", "led"),
        ("valve_pulse", "valve"),
    ):
        assert rules(verdict, actuator) == [f"{name}.{rule}"]


STOPPED = [{"emergency_stop": True}, {"maintenance": True}] + [
    {"echo": echo(cause=cause)} for cause in ("emergency_stop", "maintenance", "storage_damaged")
]
FAN_HELD = [
    {"memory": SafetyMemory(trips=("over_temperature",))},
    {"memory": SafetyMemory(trips=("heater_stuck_on",))},
    {"air": 44.0},
    {"air": 60.0},
    {"memory": SafetyMemory(sent=Command(fan_on=True), fan_since_s=NOW - 1.0, time_s=NOW - 1.0)},
]


@pytest.mark.parametrize("change", STOPPED)
@pytest.mark.parametrize("held", FAN_HELD)
def test_no_rule_starts_or_holds_the_fan_while_hands_may_be_in_the_greenhouse(change, held):
    wanted = replace(FULL, fan_on=True)
    seen = view(air=held.get("air", 25.0))
    assert judge(wanted, seen, held.get("memory")).sent.fan_on  # without the stop these all do
    assert judge(wanted, replace(seen, **change), held.get("memory")).sent == Command()


def test_the_fan_cools_again_after_a_stop_while_the_trip_stands():
    stopped = judge(FULL, view(emergency_stop=True), SafetyMemory(trips=("over_temperature",)))
    after = judge(FULL, view(echo=echo(cause="over_temperature"), now_s=NOW + 1.0), stopped.memory)
    assert not stopped.sent.fan_on and after.sent.fan_on


@pytest.mark.parametrize(
    ("change", "opens"),
    [({"emergency_stop": True}, True), ({"maintenance": True}, True), ({"link_up": False}, False)],
)
def test_stop_and_maintenance_open_the_cutoff(change, opens):
    assert judge(FULL, view(**change)).open_cutoff is opens


@pytest.mark.parametrize("cause", ["emergency_stop", "maintenance", "storage_damaged"])
def test_a_board_that_was_stopped_is_sent_nothing(cause):
    verdict = judge(replace(FULL, fan_on=True), view(air=41.0, echo=echo(cause=cause)))
    assert verdict.sent == Command()
    for actuator, name in (("fan_on", "fan"), ("led", "led"), ("valve_pulse", "valve")):
        change = only_change(verdict, actuator)
        assert (change.rule, change.reason) == (f"{name}.board_stopped", f"stopped on the board: {cause}")


def test_a_tripped_board_gets_no_heat():
    verdict = judge(FULL, view(echo=echo(cause="over_temperature")))
    assert verdict.sent == replace(FULL, heater_duty=0.0)
    assert only_change(verdict, "heater_duty").reason == "the board has tripped: over_temperature"


def test_a_board_that_has_not_answered_yet_may_be_told():
    assert judge(FULL, view(echo=None)).sent == FULL


@pytest.mark.parametrize(
    ("heater_w", "duty"), [(0.0, 0.0), (-1.0, 0.0), (math.nan, 0.0), (0.5, 1.0), (100.0, 1.0), (400.0, 1.0)]
)
def test_a_heater_of_unknown_power_does_not_heat(heater_w, duty):
    box = replace(PAPER_BOX, heater_w=heater_w)
    verdict = judge(HEAT, view(box=box), energy_hour_max_wh=400.0)
    assert verdict.sent.heater_duty == duty
    assert rules(verdict, "heater_duty") == ([] if duty else ["heater.unknown_power"])
    limits = planning_limits(SafetyMemory(), LIMITS, NOW, 60.0, box)
    assert (limits.heater_max_duty > 0.0) is bool(duty)


def test_the_bounds_of_the_papers_box_follow_its_heater():
    strong = paper_box(400.0)
    assert (strong.heater_w, strong.power_min_w, strong.power_max_w) == (400.0, 300.0, 440.0)
    assert strong.air_rate_max_k_s == pytest.approx(0.4)
    assert paper_box(100.0) == PAPER_BOX
    assert duty_below_trip(38.0, 43.0, 60.0, strong, 0.0) == pytest.approx(5.0 / 8.8)


# Heater: a light box, which one step may bring to the trip

LIGHT = replace(PAPER_BOX, capacity_min_j_k=660.0)  # full heat, 110 W, warms it by 10 K in 60 s


@pytest.mark.parametrize(
    ("temp_air", "dt_s", "box", "held", "duty"),
    [
        (38.0, 60.0, LIGHT, 0.0, 0.5),
        (38.0, 60.0, LIGHT, 0.3, 0.8),
        (38.0, 60.0, LIGHT, 0.7, 1.0),
        (38.0, 30.0, LIGHT, 0.0, 1.0),
        (38.0, 600.0, LIGHT, 0.0, 0.05),
        (33.0, 60.0, LIGHT, 0.0, 1.0),
        (20.0, 60.0, LIGHT, 0.0, 1.0),
        (43.0, 60.0, LIGHT, 0.0, 0.0),
        (50.0, 60.0, LIGHT, 0.2, 0.2),
        (42.5, 5.0, LIGHT, 0.0, 0.6),
        (50.0, 0.0, LIGHT, 0.0, 1.0),
        (None, 60.0, LIGHT, 0.0, 1.0),
        (42.0, 60.0, replace(PAPER_BOX, capacity_min_j_k=1.0), 0.0, 1.0 / 6600.0),
        (42.5, 60.0, unknown_box(100.0, "exhaust"), 0.0, 1.0),
        (39.99, 60.0, PAPER_BOX, 0.0, 1.0),
    ],
)
def test_heat_of_a_step_does_not_reach_the_trip(temp_air, dt_s, box, held, duty):
    assert duty_below_trip(temp_air, 43.0, dt_s, box, held) == pytest.approx(duty)


def test_a_light_box_near_its_limit_gets_less_heat():
    verdict = judge(FULL, view(air=38.0, box=LIGHT))
    assert 0.5 <= verdict.sent.heater_duty < 1.0
    assert rules(verdict, "heater_duty") == ["heater.below_trip"]
    held = SafetyMemory(time_s=NOW - 60.0, thermal=ThermalMemory(heat=0.7))
    assert judge(FULL, view(air=38.0, box=LIGHT), held).sent == FULL
    assert judge(FULL, view(air=32.0, box=LIGHT)).sent == FULL


HELD = ((NOW - 1200.0, 5.0), (NOW - 600.0, 5.0))  # 10 Wh of the 50 Wh of half an hour


@pytest.mark.parametrize(
    ("since_s", "heat", "duty"),
    [
        (None, HELD, 1.0),
        (NOW, HELD, 0.2),
        (NOW - 599.0, HELD, 0.2),
        (NOW - 600.0, HELD, 0.0),
        (NOW + 1.0, HELD, 0.0),
        (math.nan, HELD, 0.0),
        (NOW, (), 0.0),
        (NOW, ((NOW - 10.0, 5.0),), 0.1),
        (NOW, ((NOW - 1800.0, 50.0), *HELD), 0.2),  # before the last half hour
        (NOW, ((NOW - 1799.0, 50.0),), 1.0),
    ],
)
def test_air_whose_fall_is_contradicted_gets_what_held_it_for_ten_minutes(since_s, heat, duty):
    verdict = judge(
        HEAT,
        view(air=0.0, air_doubt=None if since_s is None else AirDoubt(since_s, "", 21.0)),
        SafetyMemory(heat=heat),
        heater_rise_per_s=1.0,
        energy_hour_max_wh=400.0,
    )
    assert verdict.sent.heater_duty == pytest.approx(duty)
    assert rules(verdict, "heater_duty")[:1] == ([] if duty == 1.0 else ["heater.air_doubted"])


UNKNOWN = unknown_box(60.0, "none")
QUICK = AirRise(NOW, 38.0, 38.0, 0.0, 0.1)  # by full heat 6 K in a minute; with its margin 7.8 K


@pytest.mark.parametrize(
    ("temp_air", "dt_s", "rise", "duty"),
    [
        (38.0, 60.0, QUICK, 5.0 / 7.8),
        (38.0, 60.0, replace(QUICK, holds=0.2), 0.2 + 5.0 / 7.8),
        (38.0, 60.0, replace(QUICK, holds=0.5), 1.0),
        (38.0, 30.0, QUICK, 1.0),
        (42.9, 6.0, QUICK, 0.1 / 0.78),
        (38.0, 0.0, QUICK, 1.0),
        (43.0, 60.0, replace(QUICK, holds=0.3), 0.3),
        # Air that has just fallen, as under an open lid, comes back.
        (30.0, 60.0, QUICK, 5.0 / 7.8),
        (39.0, 60.0, QUICK, 4.0 / 7.8),
        (38.0, 60.0, AirRise(NOW, 38.0, 38.0, -0.1, 0.1), 5.0 / 7.8),
        # Heat in the element goes on for its lag of 300 s: 0.01 K/s are 3 K.
        (38.0, 60.0, AirRise(NOW, 38.0, 38.0, 0.01, 0.1), 2.0 / 7.8),
        (38.0, 60.0, AirRise(NOW, 38.0, 38.0, 5.0 / 300.0, 0.1, 0.9), 0.0),
        (43.0, 60.0, AirRise(NOW, 43.0, 43.0, 0.5 / 300.0, 0.1, 0.9), 0.0),
        (38.0, 60.0, AirRise(NOW, 38.0, 38.0, 0.0166, 0.1, 0.9), 0.9 + 0.02 / 7.8),
        (38.0, 60.0, AirRise(NOW, 38.0, 38.0, math.nan, 0.1, 0.9), 0.0),
        (38.0, 60.0, AirRise(NOW, 38.0, 38.0, math.inf, 0.1, 0.9), 0.0),
        (38.0, 60.0, AirRise(), 1.0),
        (None, 60.0, QUICK, 1.0),
    ],
)
def test_the_measured_rise_of_an_unknown_box_keeps_its_heat_below_the_trip(temp_air, dt_s, rise, duty):
    assert duty_below_trip(temp_air, 43.0, dt_s, UNKNOWN, 0.9, rise) == pytest.approx(duty)


def test_the_tighter_of_both_bounds_counts():
    both = [duty_below_trip(38.0, 43.0, 60.0, box, 0.0, QUICK) for box in (LIGHT, UNKNOWN)]
    assert both == pytest.approx([0.5, 5.0 / 7.8])
    assert duty_below_trip(38.0, 43.0, 60.0, LIGHT, 0.9, QUICK) == pytest.approx(5.0 / 7.8)
    rising = AirRise(NOW, 38.0, 38.0, 0.01)
    assert duty_below_trip(38.0, 43.0, 60.0, LIGHT, 0.0, rising) == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("before", "passed_s", "temp_air", "after"),
    [
        (AirRise(), 60.0, 30.0, AirRise(NOW, 30.0, 30.0)),
        (AirRise(None, fastest_k_s=0.1), 60.0, 30.0, AirRise(NOW, 30.0, 30.0, 0.0, 0.1)),
        (AirRise(0.0, 27.0, 27.0), 60.0, 30.0, AirRise(NOW, 30.0, 30.0, 0.05, 0.05)),
        (AirRise(0.0, 33.0, 35.0), 60.0, 30.0, AirRise(NOW, 30.0, 33.0, -0.05, 0.0)),
        (AirRise(0.0, 27.0, 27.0), 30.0, 30.0, AirRise(NOW, 30.0, 30.0, 0.1, 0.1)),
        (AirRise(0.0, 27.0, 27.0, 0.3, 0.3), 29.0, 30.0, AirRise(NOW - 29.0, 27.0, 27.0, 0.3, 0.3)),
        (AirRise(0.0, 27.0, 27.0, 0.3, 0.3), 0.0, 30.0, AirRise(NOW, 27.0, 27.0, 0.3, 0.3)),
        (AirRise(0.0, 27.0, 27.0, 0.0, 0.1, 0.4), 60.0, None, AirRise(fastest_k_s=0.1, holds=0.4)),
        (AirRise(0.0, 27.0, 27.0), 150.0, 30.0, AirRise(NOW, 30.0, 30.0, 0.02, 0.02)),
        (AirRise(0.0, 27.0, 27.0, holds=0.4), 151.0, 30.0, AirRise(NOW, 30.0, 30.0, holds=0.4)),  # a gap
        (AirRise(0.0, 27.0, 27.0), -1.0, 30.0, AirRise(NOW, 30.0, 30.0)),
        # In six hours 0.1 K/s fades to 0.1 / e: this is a 360th of them.
        (AirRise(0.0, 30.0, 30.0, 0.0, 0.1), 60.0, 30.0, AirRise(NOW, 30.0, 30.0, 0.0, 0.09972)),
        # 0.08 K/s without heat, and 0.02 lost, are 0.1 by heat; nothing was needed to hold the air.
        (AirRise(0.0, 27.0, 27.0, 0.0, 0.1, 0.2), 60.0, 31.8,
         AirRise(NOW, 31.8, 31.8, 0.08, 0.1, 0.2 * math.exp(-0.1))),
        # It falls faster than full heat could lift it: a lid. It rises by more than all heat so far: so too.
        (AirRise(0.0, 31.8, 31.8, 0.0, 0.1), 60.0, 20.0,
         AirRise(NOW, 20.0, 31.8, -11.8 / 60.0, 0.09972, -math.expm1(-0.1))),
        (AirRise(0.0, 27.0, 27.0, 0.0, 0.05, 0.2), 60.0, 36.0,
         AirRise(NOW, 36.0, 36.0, 0.15, 0.16, 0.2 * math.exp(-0.1))),
        # Without heat it falls as 0.3 of its heat would have lifted it.
        (AirRise(0.0, 31.8, 31.8, 0.0, 0.1), 60.0, 30.0,
         AirRise(NOW, 30.0, 31.8, -0.03, 0.09972, 0.03 / 0.09972 * -math.expm1(-0.1))),
    ],
)  # fmt: skip
def test_the_rise_of_the_air_is_followed_over_half_a_minute(before, passed_s, temp_air, after):
    known = before.time_s is not None
    before = replace(before, time_s=NOW - passed_s) if known else before
    found = judge(seen=view(air=temp_air), memory=SafetyMemory(rise=before)).memory.rise
    assert found.time_s == after.time_s
    assert astuple(found)[1:] == pytest.approx(astuple(after)[1:], rel=1e-4)


@pytest.mark.parametrize(("sent", "by_full_k_s"), [(1.0, 0.05), (0.5, 0.1), (0.45, 0.05), (0.0, 0.05)])
def test_the_rise_by_full_heat_follows_from_half_of_it_and_from_no_less(sent, by_full_k_s):
    memory = SafetyMemory(sent=Command(heater_duty=sent), rise=AirRise(NOW - 60.0, 27.0, 27.0))
    assert judge(seen=view(air=30.0), memory=memory).memory.rise.fastest_k_s == pytest.approx(by_full_k_s)


def test_heat_that_did_not_show_comes_back_when_the_lid_is_shut():
    """0.8 of 0.1 K/s with its margin, without the 0.2 that held the air, for 60 s: above the last look."""
    rise = AirRise(NOW - 60.0, 30.0, 30.0, 0.0, 0.1, 0.2)
    memory = SafetyMemory(sent=Command(heater_duty=0.8), rise=rise)
    assert judge(seen=view(air=29.0), memory=memory).memory.rise.highest_c == pytest.approx(35.04)


@pytest.mark.parametrize(
    ("dt_s", "passed_s", "is_followed"), [(200.0, 500.0, True), (200.0, 501.0, False), (10.0, 149.0, True)]
)
def test_steps_of_minutes_are_no_gap(dt_s, passed_s, is_followed):
    memory = SafetyMemory(rise=AirRise(NOW - passed_s, 20.0, 20.0))
    assert (judge(seen=view(dt_s=dt_s), memory=memory).memory.rise.rate_k_s > 0.0) is is_followed


def test_hands_in_the_box_teach_nothing_of_its_heater():
    memory = SafetyMemory(rise=AirRise(NOW - 60.0, 10.0, 10.0))
    assert judge(seen=view(maintenance=True), memory=memory).memory.rise == AirRise()


def test_a_calibration_is_no_rise():
    memory = follow_calibration(SafetyMemory(rise=AirRise(NOW, 25.0, 26.0, 0.01, 0.1)), 2.0, 0.5)
    assert memory.rise == AirRise(NOW, 27.0, 28.0, 0.01, 0.1)


def test_a_quick_unknown_box_is_not_heated_into_the_trip():
    """60 s of full heat lift this air by 4 K; a controller that asks for all of it never gets to 43 °C."""
    memory, air_c, hottest_c = SafetyMemory(), 30.0, 0.0
    for k in range(120):
        seen = view(
            air=Reading("temp_air", air_c, NOW + 60.0 * k, ReadingQuality.GOOD),
            room=None,
            now_s=NOW + 60.0 * k,
            box=UNKNOWN,
        )
        wanted = Command(heater_duty=float(air_c < 39.9))
        verdict = judge(wanted, seen, memory, energy_hour_max_wh=400.0)
        memory = verdict.memory
        air_c += 4.4 * verdict.sent.heater_duty - 0.02 * (air_c - 21.0)
        hottest_c = max(hottest_c, air_c)
    assert 39.0 < hottest_c < 42.9 and memory.trips == ()


# Heater: largest duty, slew, energy


@pytest.mark.parametrize(("largest", "sent"), [(0.0, 0.0), (0.5, 0.5), (0.52, 0.5), (1.0, 1.0)])
def test_the_largest_duty_holds(largest, sent):
    assert judge(HEAT, heater_max_duty=largest).sent.heater_duty == sent


def second(duty: float, memory: SafetyMemory, now: float, rise: float) -> SafetyMemory:
    air = Reading("temp_air", 25.0, now, ReadingQuality.GOOD)
    seen = replace(view(now_s=now, dt_s=1.0), readings={"temp_air": air})
    return supervise(Command(heater_duty=duty), seen, memory, SafetySettings(heater_rise_per_s=rise)).memory


@pytest.mark.parametrize(("rise", "seconds"), [(0.05, 20), (0.1, 10), (0.02, 50), (1.0, 1)])
def test_the_duty_rises_no_faster_than_the_slew_limit(rise, seconds):
    memory, duties = SafetyMemory(), []
    for step in range(seconds + 2):
        memory = second(1.0, memory, NOW + step, rise)
        duties.append(memory.sent.heater_duty)
    assert duties == sorted(duties)
    assert all(duty <= rise * (step + 1) + 1e-9 for step, duty in enumerate(duties))
    assert duties[seconds - 1] == pytest.approx(1.0, abs=0.05)
    assert duties[-1] == 1.0


def test_ticks_that_come_a_little_early_still_let_the_duty_rise():
    memory = SafetyMemory()
    for step in range(30):
        memory = second(1.0, memory, NOW + 0.98 * step, 0.05)
    assert memory.sent.heater_duty == 1.0


def test_a_fall_is_free_and_a_rise_begins_again_from_there():
    memory = SafetyMemory(sent=HEAT, heater_ramp=1.0, time_s=NOW - 1.0)
    memory = second(0.2, memory, NOW, 0.05)
    assert memory.sent.heater_duty == 0.2
    assert second(1.0, memory, NOW + 1.0, 0.05).sent.heater_duty == 0.25


def test_a_forced_off_heater_rises_from_nothing():
    before = SafetyMemory(sent=HEAT, heater_ramp=1.0, time_s=NOW - 1.0)
    stopped = judge(HEAT, view(emergency_stop=True, dt_s=1.0), before).memory
    assert second(1.0, stopped, NOW + 1.0, 0.05).sent.heater_duty == 0.05


def test_time_that_runs_backwards_allows_no_rise():
    before = SafetyMemory(sent=Command(heater_duty=0.2), heater_ramp=0.2, time_s=NOW + 50.0)
    verdict = judge(HEAT, memory=before)
    assert verdict.sent.heater_duty == 0.2
    assert rules(verdict, "heater_duty") == ["heater.slew"]


def test_heat_is_booked_as_it_was_sent():
    memory = SafetyMemory(sent=Command(heater_duty=0.5), time_s=NOW - 60.0)
    assert heat_wh(book_heat(memory, NOW, 60.0, 100.0), NOW, 3600.0) == pytest.approx(100.0 * 0.5 / 60.0)


@pytest.mark.parametrize(
    ("last_s", "counted_s"),
    [(NOW - 70.0, 70.0), (NOW - 71.0, 70.0), (NOW - 9e9, 70.0), (NOW, 0.0), (NOW + 5.0, 0.0), (None, 0.0)],
)
def test_heat_is_booked_no_longer_than_its_lease(last_s, counted_s):
    memory = SafetyMemory(sent=HEAT, time_s=last_s)
    assert heat_wh(book_heat(memory, NOW, 60.0, 100.0), NOW, 3600.0) == pytest.approx(counted_s / 36.0)


def test_time_that_runs_backwards_takes_no_heat_off():
    memory = SafetyMemory(sent=HEAT, time_s=NOW + 5.0, heat=((NOW - 10.0, 3.0),))
    assert book_heat(memory, NOW, 60.0, 100.0).heat == memory.heat


def heated(hours: float, **limits: float) -> tuple[list[float], SafetyMemory]:
    """Duties sent in each minute while full heat is wanted all the time."""
    memory, duties = SafetyMemory(), []
    for minute in range(round(60 * hours)):
        now = NOW + 60.0 * minute
        air = Reading("temp_air", 25.0, now, ReadingQuality.GOOD)
        seen = replace(view(now_s=now, utc=UTC + now, echo=None), readings={"temp_air": air})
        verdict = supervise(HEAT, seen, memory, SafetySettings(**limits))
        memory = verdict.memory
        duties.append(verdict.sent.heater_duty)
    return duties, memory


def test_the_default_caps_leave_an_hour_of_full_heat_alone():
    assert set(heated(3.0)[0]) == {1.0}


def test_the_hour_cap_holds_in_every_hour():
    duties, _ = heated(5.0, energy_hour_max_wh=40.0)
    heat = [100.0 * duty / 60.0 for duty in duties]
    assert (
        max(sum(heat[k : k + 60]) for k in range(len(heat) - 60)) <= 40.0 * 7 / 6 + 1e-6
    )  # pieces of 10 min
    assert sum(heat) > 0.9 * 5 * 40.0 * 6 / 7
    assert sum(heat[:60]) == pytest.approx(40.0, abs=0.1)


def test_the_day_cap_holds_through_the_day():
    duties, memory = heated(24.0, energy_day_max_wh=500.0)
    assert sum(duties) * 100.0 / 60.0 == pytest.approx(500.0, abs=0.1)
    assert heat_wh(memory, NOW + DAY_S - 60.0, DAY_S) <= 500.0 + 1e-6


def test_a_used_up_cap_names_itself():
    full_hour = SafetyMemory(heat=((NOW - 100.0, 40.0),))
    assert rules(judge(HEAT, memory=full_hour, energy_hour_max_wh=40.0), "heater_duty") == [
        "heater.energy_hour"
    ]
    assert rules(judge(HEAT, memory=full_hour, energy_day_max_wh=40.0), "heater_duty") == [
        "heater.energy_day"
    ]


@pytest.mark.parametrize(("age_s", "duty"), [(3599.0, 0.0), (3600.0, 1.0)])
def test_heat_of_an_hour_ago_counts_no_more(age_s, duty):
    memory = SafetyMemory(heat=((NOW - age_s, 40.0),))
    assert judge(HEAT, memory=memory, energy_hour_max_wh=40.0).sent.heater_duty == duty


def test_heat_is_kept_in_pieces_of_ten_minutes_for_a_day():
    memory = SafetyMemory(sent=HEAT, time_s=NOW - 36.0, heat=((NOW - DAY_S, 7.0), (NOW - 599.9, 2.0)))
    assert book_heat(memory, NOW, 60.0, 100.0).heat == ((NOW - 599.9, 3.0),)
    memory = replace(memory, heat=((NOW - DAY_S + 0.1, 7.0), (NOW - 600.0, 2.0)))
    assert book_heat(memory, NOW, 60.0, 100.0).heat == (*memory.heat, (NOW, 1.0))


def test_a_heater_that_is_off_books_nothing():
    assert book_heat(SafetyMemory(time_s=NOW - 60.0), NOW, 60.0, 100.0).heat == ()


@pytest.mark.parametrize(
    ("cap_wh", "dt_s", "duty"),
    [(100.0, 60.0, 1.0), (99.9, 60.0, 1.0), (31.0, 60.0, 0.6), (30.0, 60.0, 0.0), (29.0, 60.0, 0.0),
     (31.0, 0.0, 0.0)],
)  # fmt: skip
def test_the_duty_left_is_what_the_cap_leaves(cap_wh, dt_s, duty):
    memory = SafetyMemory(heat=((NOW - 100.0, 30.0),))
    limits = SafetySettings(energy_hour_max_wh=cap_wh)
    assert energy_duty(memory, limits, NOW, dt_s, 3600.0, 100.0) == pytest.approx(duty)


# Fan relay


@pytest.mark.parametrize(
    ("held_s", "fan"), [(0.0, True), (59.4, True), (59.5, False), (60.0, False), (1e9, False)]
)
def test_the_relay_stays_on_its_minimum_time(held_s, fan):
    memory = SafetyMemory(sent=FAN, fan_since_s=NOW - held_s, time_s=NOW - 1.0)
    verdict = judge(Command(), memory=memory, fan_min_on_s=60.0)
    assert verdict.sent.fan_on is fan
    assert rules(verdict, "fan_on") == (["fan.min_on"] if fan else [])


@pytest.mark.parametrize(("held_s", "fan"), [(0.0, False), (59.4, False), (59.5, True), (1e9, True)])
def test_the_relay_stays_off_its_minimum_time(held_s, fan):
    memory = SafetyMemory(fan_since_s=NOW - held_s, time_s=NOW - 1.0)
    verdict = judge(FAN, memory=memory, fan_min_off_s=60.0)
    assert verdict.sent.fan_on is fan
    assert rules(verdict, "fan_on") == ([] if fan else ["fan.min_off"])


@pytest.mark.parametrize(("fan", "wanted"), [(True, False), (False, True)])
def test_each_relay_state_has_its_own_time(fan, wanted):
    memory = SafetyMemory(sent=Command(fan_on=fan), fan_since_s=NOW - 100.0)
    own = {"fan_min_on_s" if fan else "fan_min_off_s": 101.0}
    other = {"fan_min_off_s" if fan else "fan_min_on_s": 101.0}
    assert judge(Command(fan_on=wanted), memory=memory, **own).sent.fan_on is fan
    assert judge(Command(fan_on=wanted), memory=memory, **other).sent.fan_on is wanted


def test_safety_forces_the_fan_on_within_its_minimum_off_time():
    memory = SafetyMemory(fan_since_s=NOW - 1.0, time_s=NOW - 1.0)
    assert judge(Command(), view(air=40.0), memory).sent.fan_on is True


def test_at_the_start_the_relay_is_free():
    assert judge(FAN).sent.fan_on is True


def test_relay_time_counts_from_the_last_switching():
    memory = judge(FAN).memory
    assert memory.fan_since_s == NOW
    assert judge(FAN, view(now_s=NOW + 5.0), memory).memory.fan_since_s == NOW


# Valve


@pytest.mark.parametrize(
    ("tank", "water"),
    [(0.1, 2.0), (0.0999, 0.0), (0.0, 0.0), (1.0, 2.0), *((bad, 0.0) for bad in NOT_NUMBERS)],
)
def test_no_water_without_a_known_level_in_the_tank(tank, water):
    verdict = judge(WATER, view(tank=tank))
    assert verdict.sent.valve_pulse_s == water
    assert rules(verdict, "valve_pulse") == ([] if water else ["valve.tank"])


@pytest.mark.parametrize(
    ("soil", "water"),
    [(0.7999, 2.0), (0.8, 0.0), (1.0, 0.0), (0.0, 2.0), *((bad, 0.0) for bad in NOT_NUMBERS)],
)
def test_no_water_into_wet_or_unknown_soil(soil, water):
    verdict = judge(WATER, view(soil=soil))
    assert verdict.sent.valve_pulse_s == water
    assert rules(verdict, "valve_pulse") == ([] if water else ["valve.soil"])


@pytest.mark.parametrize("signal", ["tank", "soil"])
def test_an_old_water_reading_gives_no_water(signal):
    name = {"tank": "tank_level", "soil": "soil_moisture"}[signal]
    assert judge(WATER, view(**{signal: reading(name, 0.5, 10.0)})).sent.valve_pulse_s == 2.0
    assert judge(WATER, view(**{signal: reading(name, 0.5, 10.1)})).sent.valve_pulse_s == 0.0


@pytest.mark.parametrize(
    ("wanted", "sent"), [(0.1, 0.1), (0.09, 0.0), (4.99, 4.9), (5.0, 5.0), (5.1, 5.0), (1e9, 5.0)]
)
def test_a_pulse_is_bounded(wanted, sent):
    assert judge(Command(valve_pulse_s=wanted)).sent.valve_pulse_s == sent


@pytest.mark.parametrize(
    ("given_s", "sent"), [(0.0, 2.0), (58.0, 2.0), (59.0, 1.0), (60.0, 0.0), (99.0, 0.0)]
)
def test_the_dose_of_the_day_is_bounded(given_s, sent):
    memory = SafetyMemory(doses=(Dose(NOW - 100.0, UTC - 100.0, given_s),))
    verdict = judge(WATER, memory=memory)
    assert verdict.sent.valve_pulse_s == sent
    assert rules(verdict, "valve_pulse") == ([] if sent == 2.0 else ["valve.day_max"])


@pytest.mark.parametrize(("age_s", "sent"), [(DAY_S - 1.0, 0.0), (DAY_S, 2.0), (-50.0, 0.0)])
def test_water_counts_for_a_day(age_s, sent):
    running = SafetyMemory(doses=(Dose(NOW - age_s, 0.0, 60.0),))
    assert judge(WATER, memory=running).sent.valve_pulse_s == sent
    restarted = SafetyMemory(doses=(Dose(None, UTC - age_s, 60.0),))
    assert judge(WATER, memory=restarted).sent.valve_pulse_s == sent


def test_what_is_given_is_remembered_and_what_is_old_forgotten():
    memory = SafetyMemory(doses=(Dose(NOW - DAY_S, UTC - DAY_S, 9.0),))
    after = judge(WATER, memory=memory).memory
    assert after.doses == (Dose(NOW, UTC, 2.0),)
    assert water_s(after, NOW, UTC) == 2.0


def test_no_pulse_is_no_dose():
    assert judge(Command()).memory.doses == ()
    assert len(judge(Command(valve_pulse_s=0.1)).memory.doses) == 1


def test_the_valve_works_while_the_heater_is_tripped():
    assert judge(WATER, memory=SafetyMemory(trips=("over_temperature",))).sent.valve_pulse_s == 2.0


# Thermal supervision: what it is shown

WATCHED = ThermalMemory(off_s=100.0)


@pytest.mark.parametrize(
    ("passed_s", "dt_s", "goes_on"),
    [(60.0, 60.0, True), (0.0, 60.0, True), (-0.01, 60.0, False), (0.5, 1.0, True), (150.0, 60.0, True),
     (150.1, 60.0, False), (150.0, 1.0, True), (150.1, 1.0, False), (1500.0, 600.0, True),
     (1500.1, 600.0, False), (math.nan, 60.0, False)],
)  # fmt: skip
def test_thermal_supervision_goes_on_over_short_gaps_only(passed_s, dt_s, goes_on):
    memory = SafetyMemory(time_s=NOW - passed_s, thermal=WATCHED)
    thermal = judge(Command(), view(dt_s=dt_s), memory).memory.thermal
    assert thermal.off_s == (pytest.approx(100.0 + passed_s) if goes_on else 0.0)


@pytest.mark.parametrize("unknown", [{"air": None}, {"echo": None}, {"link_up": False}])
def test_thermal_supervision_begins_anew_where_something_is_not_known(unknown):
    memory = SafetyMemory(time_s=NOW - 60.0, thermal=WATCHED)
    assert judge(Command(), view(**unknown), memory).memory.thermal == ThermalMemory()


def test_a_sensor_in_a_hand_is_not_judged():
    memory = SafetyMemory(time_s=NOW - 60.0, thermal=replace(WATCHED, cold_s=1e6))
    assert judge(Command(), view(air=5.0), memory).memory.trips == ("sensor_offset",)
    held = judge(Command(), view(air=5.0, maintenance=True), memory).memory
    assert (held.trips, held.thermal) == ((), ThermalMemory())


def test_another_calibration_moves_what_thermal_supervision_remembers():
    memory = SafetyMemory(thermal=replace(WATCHED, excess_k=3.0, fan_begin_excess_k=8.0))
    moved = follow_calibration(memory, 2.0, -1.0).thermal
    assert (moved.excess_k, moved.fan_begin_excess_k, moved.off_s) == (6.0, 11.0, 100.0)


def test_thermal_supervision_begins_with_the_second_decision():
    assert judge(Command(), view(), SafetyMemory(thermal=WATCHED)).memory.thermal == ThermalMemory()


def risen(minutes: int, memory: SafetyMemory) -> SafetyMemory:
    """The board says that heater is off and fan on while the air stays 3.8 K above the room."""
    for minute in range(minutes):
        now = NOW + 60.0 * minute
        seen = view(air=24.8, now_s=now, echo=echo(fan=True))
        fresh = {name: replace(value, time_s=now) for name, value in seen.readings.items()}
        memory = judge(Command(), replace(seen, readings=fresh), memory).memory
    return memory


def test_a_relay_that_is_stuck_on_latches():
    memory = risen(30, SafetyMemory(trips=("sensor_offset",)))
    assert "heater_stuck_on" in memory.trips and memory.trips[0] == "sensor_offset"
    assert judge(HEAT, memory=memory).open_cutoff


def test_a_fan_known_not_to_work_is_no_proof_of_heat():
    assert "heater_stuck_on" not in risen(30, SafetyMemory(trips=("fan_no_effect",))).trips


def test_clearing_a_trip_begins_thermal_supervision_anew():
    cleared = clear_trip(SafetyMemory(trips=("heater_stuck_on",), thermal=WATCHED), LIMITS, 25.0)
    assert cleared.thermal == ThermalMemory()


# LED


@pytest.mark.parametrize(("largest", "sent"), [(0.0, 0.0), (0.4, 0.4), (1.0, 1.0)])
def test_the_led_is_bounded(largest, sent):
    assert judge(Command(led=1.0), led_max=largest).sent.led == sent


# What a change says


def test_a_change_says_what_was_wanted_and_what_was_sent():
    change = only_change(judge(Command(heater_duty=0.8), heater_max_duty=0.5), "heater_duty")
    assert (change.rule, change.wanted, change.sent, change.reason) == (
        "heater.max_duty", 0.8, 0.5, "largest duty",
    )  # fmt: skip


# Planning


def test_with_nothing_in_the_way_a_controller_may_plan_all():
    limits = planning_limits(SafetyMemory(), LIMITS, NOW, 60.0)
    assert (limits.heater_max_duty, limits.fan_hold_steps, limits.fan_min_on_steps) == (1.0, 0, 1)
    assert limits.temp_air_max_c == 40.0


@pytest.mark.parametrize(
    ("step_s", "held_s", "hold", "minimum"),
    [
        (60.0, 0.0, 1, 1),
        (60.0, 59.5, 0, 1),
        (60.0, 60.0, 0, 1),
        (60.0, 3600.0, 0, 1),
        (1.0, 0.0, 60, 60),
        (1.0, 30.0, 30, 60),
        (45.0, 0.0, 2, 2),
        (600.0, 0.0, 1, 1),
    ],
)
def test_a_controller_knows_how_long_the_relay_is_held(step_s, held_s, hold, minimum):
    memory = SafetyMemory(sent=FAN, fan_since_s=NOW - held_s)
    held = SafetySettings(fan_min_on_s=60.0, fan_min_off_s=60.0)
    limits = planning_limits(memory, held, NOW, step_s)
    assert (limits.fan_hold_steps, limits.fan_min_on_steps, limits.fan_min_off_steps) == (
        hold,
        minimum,
        minimum,
    )


def test_a_relay_without_minimum_times_lasts_one_step():
    limits = planning_limits(SafetyMemory(), SafetySettings(fan_min_on_s=0.0, fan_min_off_s=0.0), NOW, 60.0)
    assert (limits.fan_min_on_steps, limits.fan_min_off_steps) == (1, 1)


def test_a_controller_knows_the_largest_duty():
    assert planning_limits(SafetyMemory(trips=("x",)), LIMITS, NOW, 60.0).heater_max_duty == 0.0
    assert (
        planning_limits(SafetyMemory(), SafetySettings(heater_max_duty=0.4), NOW, 60.0).heater_max_duty == 0.4
    )
    used = SafetyMemory(heat=((NOW - 100.0, 39.0),))
    limits = planning_limits(used, SafetySettings(energy_hour_max_wh=40.0), NOW, 60.0)
    assert limits.heater_max_duty == pytest.approx(0.6)  # 1 Wh in a minute


@pytest.mark.parametrize(
    ("is_foreign", "why"), [(False, "no link to the board"), (True, "another board is at the port")]
)
def test_a_link_that_is_down_is_named_by_its_cause(is_foreign, why):
    seen = view(link_up=False, is_foreign=is_foreign)
    assert why in [change.reason for change in judge(HEAT, seen).changes]


# Over a restart


def test_trips_and_water_outlive_the_process():
    memory = SafetyMemory(trips=("over_temperature", "fan_no_effect"), doses=(Dose(NOW, UTC, 2.0),))
    again = decode_safety(json.loads(json.dumps(encode_safety(memory))))
    assert again == SafetyMemory(trips=memory.trips, doses=(Dose(None, UTC, 2.0),))


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({"trips": ("over_temperature",)}, False),
        ({"doses": (Dose(NOW, UTC, 2.0),)}, False),
        ({"heat": ((NOW - 600.0, 5.0), (NOW, 1.0))}, False),  # every ten minutes of heat
        ({"heat": ((NOW - 600.0, 5.5),), "time_s": NOW, "sent": Command(heater_duty=0.5)}, True),
        ({"heat": ()}, False),
        ({"air_doubt": AirDoubt(NOW, "", 21.0)}, False),
    ],
)
def test_a_change_of_trips_water_or_pieces_of_heat_calls_for_a_save(change, same):
    before = SafetyMemory(heat=((NOW - 600.0, 5.0),))
    assert survives_as(replace(before, **change), before) is same


@pytest.mark.parametrize("last_s", [None, NOW - 1000.0], ids=["after a start", "after a gap"])
def test_no_gap_puts_off_the_next_proof_of_the_relay(last_s):
    proof = RelayProof(since_s=300.0, heated_s=200.0, fanned_s=100.0, running_s=50.0, highest_c=30.0)
    memory = SafetyMemory(time_s=last_s, thermal=replace(WATCHED, proof=proof))
    kept = RelayProof(since_s=300.0, heated_s=200.0, fanned_s=100.0)
    assert judge(Command(), memory=memory).memory.thermal == ThermalMemory(proof=kept)


@pytest.mark.parametrize("length_s", [0.0, 0.1, 1.0])
def test_a_dose_of_any_length_is_read_again(length_s):
    assert decode_safety({"trips": [], "doses": [[UTC, length_s]]}).doses == (Dose(None, UTC, length_s),)


@pytest.mark.parametrize(
    "values",
    [{}, {"trips": []}, {"trips": "x", "doses": []}, {"trips": [1], "doses": []}, {"trips": [], "doses": [1]},
     {"trips": [], "doses": [["x", 1]]}, {"trips": [], "doses": [[1, 2, 3]]}, {"trips": None, "doses": []},
     *({"trips": [], "doses": [dose]} for dose in
       ([math.nan, 2.0], [math.inf, 2.0], [UTC, math.nan], [UTC, math.inf], [UTC, -0.1]))],
)  # fmt: skip
def test_a_memory_nobody_wrote_is_refused(values):
    with pytest.raises(DataError, match=r"^safety"):
        decode_safety(values)


# Anything at all

numbers = st.one_of(
    st.none(),
    st.floats(allow_nan=True, allow_infinity=True),
    st.floats(0.0, 1.2),
    st.floats(36.0, 44.0),
    st.integers(-3, 50),
)
duties = st.sampled_from([k / 20 for k in range(21)])
readings_strategy = st.builds(
    lambda value, age_s, quality: (value, age_s, quality),
    numbers,
    st.one_of(st.floats(-1.0, 12.0), st.floats(allow_nan=True)),
    st.sampled_from([ReadingQuality.GOOD, ReadingQuality.GOOD, *ReadingQuality]),
)
views = st.builds(
    lambda air, soil, tank, room, link, stop, maintenance, answered, duty, fan, cause, dt: view(
        air=reading("temp_air", *air),
        soil=reading("soil_moisture", *soil),
        tank=reading("tank_level", *tank),
        room=reading("temp_ambient", *room),
        link_up=link,
        emergency_stop=stop,
        maintenance=maintenance,
        echo=echo(duty, fan, cause) if answered else None,
        dt_s=dt,
    ),
    *(readings_strategy,) * 4,
    *(st.booleans(),) * 4,
    duties,
    st.booleans(),
    st.sampled_from(["", "", "over_temperature", "emergency_stop", "maintenance"]),
    st.floats(0.01, 600.0),
)
commands = st.builds(Command, numbers, st.one_of(st.booleans(), numbers), numbers, numbers)
memories = st.builds(
    SafetyMemory,
    trips=st.sampled_from([(), (), ("over_temperature",), ("fan_no_effect", "heater_stuck_on")]),
    sent=st.builds(Command, duties, st.booleans(), duties),
    heater_ramp=st.floats(0.0, 1.0),
    time_s=st.one_of(st.none(), st.floats(0.0, 2.0 * NOW)),
    fan_since_s=st.one_of(st.none(), st.floats(0.0, 2.0 * NOW)),
    heat=st.lists(st.tuples(st.floats(0.0, NOW), st.floats(0.0, 20.0)), max_size=3).map(tuple),
    doses=st.lists(
        st.builds(Dose, st.one_of(st.none(), st.floats(0.0, NOW)), st.floats(0.0, UTC), st.floats(0.0, 30.0)),
        max_size=3,
    ).map(tuple),
)


@settings(max_examples=300, deadline=None)
@given(commands, views, memories)
def test_whatever_comes_in_a_legal_command_comes_out(wanted, seen, memory):
    verdict = supervise(wanted, seen, memory, LIMITS)
    sent, air = verdict.sent, seen.readings["temp_air"]
    assert sent.heater_duty * 20 == round(sent.heater_duty * 20) and 0.0 <= sent.heater_duty <= 1.0
    assert type(sent.fan_on) is bool
    assert 0.0 <= sent.led <= 1.0 and 0.0 <= sent.valve_pulse_s <= LIMITS.valve_pulse_max_s
    fresh = air.quality is ReadingQuality.GOOD and air.value is not None and math.isfinite(air.value)
    fresh = fresh and -0.5 <= seen.now_s - air.time_s <= LIMITS.reading_age_max_s
    if not fresh or not air.value < LIMITS.temp_air_max_c:
        assert sent.heater_duty == 0.0
    stopped = seen.echo is not None and seen.echo.stopped
    if seen.emergency_stop or seen.maintenance or stopped or not seen.link_up:
        assert sent == Command()
    elif fresh and air.value >= LIMITS.temp_air_max_c:
        assert sent.fan_on
    if verdict.memory.trips:
        assert sent.heater_duty == 0.0
    assert set(memory.trips) <= set(verdict.memory.trips)
    assert (
        sum(d.length_s for d in verdict.memory.doses if d.is_recent(NOW, UTC))
        <= max(LIMITS.valve_day_max_s, water_s(memory, NOW, UTC)) + 1e-6
    )


@settings(max_examples=200, deadline=None)
@given(commands, views, memories)
def test_what_differs_says_why_and_the_answer_is_always_the_same(wanted, seen, memory):
    verdict = supervise(wanted, seen, memory, LIMITS)
    assert supervise(wanted, seen, memory, LIMITS) == verdict or any(
        change.wanted != change.wanted for change in verdict.changes
    )  # NaN is not equal to itself
    changed = {change.actuator for change in verdict.changes}
    for actuator, before, after in (
        ("heater_duty", wanted.heater_duty, verdict.sent.heater_duty),
        ("fan_on", wanted.fan_on, verdict.sent.fan),
        ("led", wanted.led, verdict.sent.led),
        ("valve_pulse", wanted.valve_pulse_s, verdict.sent.valve_pulse_s),
    ):
        if before is None or not abs(before - after) <= 1e-9:
            assert actuator in changed
    assert all(change.reason and "." in change.rule for change in verdict.changes)


def test_a_planner_is_told_of_the_proof():
    def told(proof: RelayProof) -> int | None:
        memory = SafetyMemory(thermal=ThermalMemory(proof=proof))
        return planning_limits(memory, SafetySettings(), 0.0, 60.0).proof_in_steps

    assert told(RelayProof()) is None
    assert told(RelayProof(running_s=0.0)) == 0
    assert told(RelayProof(since_s=EVERY_S - 1790.0, heated_s=3000.0, fanned_s=3000.0)) == 30
