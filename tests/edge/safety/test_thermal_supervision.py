"""edge/safety/thermal_supervision.py: each question at its edge, then against the simulated chamber.

The chamber shares no code with edge/; the bounds below are stated in the module's docstring.
"""

from dataclasses import replace

import numpy as np
import pytest

from edge.safety.thermal_supervision import (
    COLD_S,
    COOLING_S,
    FAN_NO_EFFECT,
    HEATER_NO_EFFECT,
    HEATER_STUCK_ON,
    LONG_S,
    SENSOR_OFFSET,
    Balance,
    Observation,
    ThermalMemory,
    look,
    shift_readings,
    unordered_w,
)
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load

pytestmark = pytest.mark.slow

REST = Observation(60.0, 21.0, 21.0, heater_duty=0.0, fan_on=False, led=0.0)


def first_trip(moments: list[Observation], memory: ThermalMemory | None = None) -> tuple[str, float] | None:
    """The first fault and the time it took [s]."""
    memory, passed_s = memory or ThermalMemory(), 0.0
    for moment in moments:
        memory, findings = look(memory, moment)
        passed_s += moment.dt_s
        if findings:
            return findings[0].trip, passed_s
    return None


# Heater on and no rise


@pytest.mark.parametrize("dt_s", [1.0, 10.0, 60.0])
def test_full_heat_without_any_rise_is_told_after_a_quarter_of_an_hour(dt_s):
    trip, passed_s = first_trip([replace(REST, dt_s=dt_s, heater_duty=1.0)] * round(3600 / dt_s))
    assert trip == HEATER_NO_EFFECT
    assert 780.0 <= passed_s <= 900.0


@pytest.mark.parametrize(("rise_k", "trip"), [(0.0, HEATER_NO_EFFECT), (0.9, HEATER_NO_EFFECT), (1.1, None)])
def test_a_rise_of_a_kelvin_is_a_sign_of_life(rise_k, trip):
    air = [21.0] * 5 + [21.0 + rise_k] * 15
    found = first_trip([replace(REST, temp_air=a, heater_duty=1.0) for a in air])
    assert (found and found[0]) == trip


def test_a_rise_after_an_open_door_counts_from_the_coldest():
    dip = [30.0, 26.0, 23.0, 22.0, 22.0, 22.2, *(22.2 + 0.2 * k for k in range(20))]
    assert first_trip([replace(REST, temp_air=air, heater_duty=1.0) for air in dip]) is None


def test_with_the_fan_on_no_rise_proves_nothing():
    assert first_trip([replace(REST, temp_air=21.5, heater_duty=1.0, fan_on=True)] * 600) is None


def test_without_a_room_temperature_no_rise_proves_nothing():
    assert first_trip([replace(REST, temp_ambient=None, heater_duty=1.0)] * 600) is None


@pytest.mark.parametrize("air", [28.6, 36.0])
def test_a_warm_box_in_balance_proves_nothing(air):
    assert first_trip([replace(REST, temp_air=air, heater_duty=1.0)] * 600) is None


def test_little_heat_takes_longer_to_judge():
    _, full_s = first_trip([replace(REST, heater_duty=1.0)] * 600)
    _, half_s = first_trip([replace(REST, heater_duty=0.5)] * 600)
    assert half_s > 1.5 * full_s


def test_a_pause_of_the_heater_begins_the_question_anew():
    pulse = [replace(REST, heater_duty=1.0)] * 8 + [REST]
    assert first_trip(pulse * 20) is None


# More heat than was ordered


def test_air_that_stays_warm_without_heat_is_told():
    trip, passed_s = first_trip([replace(REST, temp_air=34.0)] * 60)  # 13 K * 4 W/K = 52 W
    assert (trip, passed_s) == (HEATER_STUCK_ON, 900.0)


def test_what_sun_or_a_pump_can_do_is_nobodys_fault():
    assert first_trip([replace(REST, temp_air=28.0)] * 600) is None  # 28 W


def test_a_box_that_cools_is_no_fault():
    cooling = [replace(REST, temp_air=21.0 + 17.0 * 0.95**k) for k in range(180)]
    assert first_trip(cooling) is None


def test_a_quick_rise_after_the_fan_stops_is_warm_walls():
    fan = [replace(REST, temp_air=22.5, fan_on=True)] * 30
    rebound = [replace(REST, temp_air=air) for air in (23.0, 23.5, 23.9, 24.1, 24.1, *[24.0] * 60)]
    assert first_trip(fan + rebound) is None


def test_the_leds_heat_is_taken_off():
    warm = replace(REST, temp_air=34.0)
    assert first_trip([replace(warm, led=1.0)] * 60) is None
    assert first_trip([replace(warm, temp_air=39.5, led=1.0)] * 60) is not None


def test_ordered_heat_is_taken_off():
    kept_warm = [replace(REST, temp_air=30.0, heater_duty=0.5)] * 600
    assert first_trip(kept_warm) is None


def test_a_relay_that_is_stuck_while_the_fan_keeps_switching_is_told_within_two_hours():
    cycle = [replace(REST, temp_air=29.0), replace(REST, temp_air=27.0, fan_on=True)]
    trip, passed_s = first_trip(cycle * 120)
    assert trip == HEATER_STUCK_ON
    assert LONG_S <= passed_s <= 2.0 * LONG_S


def test_without_a_room_temperature_only_a_rise_counts():
    unknown = replace(REST, temp_ambient=None)
    assert first_trip([replace(unknown, temp_air=38.0)] * 600) is None
    rising = [replace(unknown, temp_air=21.0 + 0.8 * k) for k in range(30)]
    assert first_trip(rising)[0] == HEATER_STUCK_ON


@pytest.mark.parametrize(
    ("change_k", "excess_k", "fan", "ordered_w", "heat_w"),
    [
        (0.0, 10.0, 0.0, 0.0, 40.0),
        (0.0, 10.0, 1.0, 0.0, 150.0),
        (6.0, 0.0, 0.0, 0.0, 30.0),  # 3000 J/K * 6 K / 600 s
        (-6.0, 0.0, 0.0, 0.0, -100.0),  # 10000 J/K
        (0.0, 10.0, 0.0, 25.0, 15.0),
        (0.0, -5.0, 0.0, 0.0, -20.0),
    ],
)
def test_the_balance_is_what_is_stored_and_lost_less_what_was_ordered(
    change_k, excess_k, fan, ordered_w, heat_w
):
    balance = Balance(25.0, 25.0, 600.0, 600.0 * excess_k, 600.0 * excess_k * fan, 600.0 * ordered_w)
    assert unordered_w(balance, 25.0 + change_k) == pytest.approx(heat_w)


# Fan on and no cooling


def fan_on(air: list[float], duty: float = 0.0) -> list[Observation]:
    return [replace(REST, temp_air=air[0])] + [
        replace(REST, temp_air=a, fan_on=True, heater_duty=duty) for a in air
    ]


def test_a_fan_that_does_not_cool_is_told_in_five_minutes():
    assert first_trip(fan_on([36.0 - 0.7 * k for k in range(10)])) == (FAN_NO_EFFECT, 60.0 + COOLING_S)


@pytest.mark.parametrize(("left_share", "trip"), [(0.69, None), (0.71, FAN_NO_EFFECT)])
def test_a_fan_must_take_three_tenths_of_the_excess_away(left_share, trip):
    found = first_trip(fan_on([36.0, *[21.0 + 15.0 * left_share] * 9]))
    assert (found and found[0]) == trip


@pytest.mark.parametrize(("left_k", "trip"), [(10.4, None), (10.6, FAN_NO_EFFECT)])
def test_what_a_fan_takes_away_within_its_first_step_counts(left_k, trip):
    # 15 K above the room when it is told on; a light box is cool before the next look.
    cooled = replace(REST, temp_air=21.0 + left_k, fan_on=True)
    found = first_trip([replace(REST, temp_air=36.0), *[cooled] * 9])
    assert (found and found[0]) == trip


@pytest.mark.parametrize(("left_k", "trip"), [(17.4, None), (17.6, FAN_NO_EFFECT)])
def test_cooling_counts_from_the_warmest_air_since_the_fan_was_switched(left_k, trip):
    # 15 K above the room when the fan starts, 25 K a minute later: 0.7 * 25 K may be left.
    found = first_trip(fan_on([36.0, 46.0, 44.0, 41.0, *[21.0 + left_k] * 6]))
    assert (found and found[0]) == trip


@pytest.mark.parametrize(("excess_k", "trip"), [(13.1, None), (13.2, FAN_NO_EFFECT)])
def test_a_fan_at_a_third_of_its_flow_may_leave_what_full_heat_makes(excess_k, trip):
    # 110 W into 8 W/K of a weak fan and 4 W/K of the walls, and 4 K of other heat: 13.17 K.
    found = first_trip(fan_on([21.0 + excess_k] * 10, duty=1.0))
    assert (found and found[0]) == trip


def test_a_fan_that_cools_is_no_fault():
    assert first_trip(fan_on([36.0, 29.0, 27.0, 26.0, 25.0, 24.0, *[22.8] * 60])) is None


def test_a_weak_fan_against_full_heat_is_no_fault():
    assert first_trip(fan_on([25.0 + 0.5 * min(k, 6) for k in range(120)], duty=1.0)) is None


def test_a_fan_in_a_cool_box_has_nothing_to_cool():
    assert first_trip(fan_on([24.9] * 10)) is None


def test_without_a_room_temperature_no_fan_is_judged():
    warm_room = [replace(moment, temp_ambient=None) for moment in fan_on([35.0] * 30)]
    assert first_trip(warm_room) is None


# Air colder than the room


@pytest.mark.parametrize(("air", "tripped"), [(17.0, False), (16.99, True), (0.0, True)])
def test_air_that_is_colder_than_the_room_is_a_wrong_sensor(air, tripped):
    assert first_trip([replace(REST, temp_air=air)] * 60) == ((SENSOR_OFFSET, COLD_S) if tripped else None)


def test_a_room_that_warms_quickly_is_no_fault():
    cold = [replace(REST, temp_air=16.0)] * 29
    assert first_trip([*cold, REST, *cold]) is None


# The chamber

PARAMETERS, EFFECTS = load()
HOSTILE = replace(
    EFFECTS, door_opening=1.0, sun_window=1.0, constant_heat=1.0, heat_noise=2.0, room_draught=1.0,
    ambient_wander=4.0, ambient_diurnal=4.0, heater_deadtime=1.0, heater_sag=1.0, heater_saturation=1.0,
    short_circuit=1.0, sensor_radiation=1.0, stack_ventilation=1.0,
)  # fmt: skip


class SupervisedBox:
    """The chamber, what it is told, and what is wrong with it."""

    def __init__(self, seed: int, effects=EFFECTS) -> None:
        self.chamber = Chamber(PARAMETERS, effects, seed)
        self.memory = ThermalMemory()
        self.faults: dict[str, float] = {}  # "heater" or "fan" -> what really happens
        self.sensed = self.chamber.sense()
        self.minutes = 0
        self.found: list[str] = []

    def minute(self, duty: float, fan: bool, led: float = 0.0) -> None:
        on_s = round(20 * self.faults.get("heater", duty))  # slow PWM: 20 slots of 1 s
        flows = bool(self.faults.get("fan", fan))
        for _ in range(3):
            self.chamber.step(float(on_s), 1.0, flows, led, False)
            self.chamber.step(float(20 - on_s), 0.0, flows, led, False)
        self.sensed = self.chamber.sense()
        moment = Observation(60.0, self.air, self.sensed["temp_ambient_c"], duty, fan, led)
        self.memory, findings = look(self.memory, moment)
        self.found += [finding.trip for finding in findings]
        self.minutes += 1

    @property
    def air(self) -> float:
        return self.sensed["temp_air_c"]

    def run(self, minutes: int, duty: float, fan: bool) -> "SupervisedBox":
        for _ in range(minutes):
            self.minute(duty, fan)
        return self

    def until_found(self, duty: float, fan: bool, limit: int = 240) -> int:
        """Minutes from now to the first fault found."""
        begin, self.found = self.minutes, []
        while not self.found and self.minutes - begin < limit:
            self.minute(duty, fan)
        return self.minutes - begin


def drive(box: SupervisedBox, style: str, minutes: int, seed: int) -> SupervisedBox:
    """A day's life: references come and go, switched or smoothed or at random."""
    random = np.random.default_rng(seed)
    reference, duty, fan, integral = 24.0, 0.0, False, 0.0
    for _ in range(minutes):
        if random.random() < 1 / 90:
            reference = random.uniform(20.0, 36.0)
        error = reference - box.air
        match style:
            case "thermostat":
                duty = 1.0 if error > 0.3 else 0.0 if error < -0.3 else duty
                fan = error < -1.5 or (fan and error < 0.0)
            case "chatter":
                duty, fan = float(error > 0.0), error < 0.0
            case "smooth":
                integral = min(1.0, max(0.0, integral + 0.02 * error))
                duty, fan = round(20 * min(1.0, max(0.0, integral + 0.3 * error))) / 20, error < -1.0
            case "random":
                duty = float(random.integers(0, 21)) / 20 if random.random() < 0.1 else duty
                fan = bool(random.random() < 0.4) if random.random() < 0.1 else fan
        box.minute(duty, fan, led=float(box.minutes % 1440 > 480))
        if box.found:
            break
    return box


@pytest.mark.parametrize(
    ("style", "effects"),
    [
        ("smooth", EFFECTS),
        ("random", EFFECTS),
        *((style, HOSTILE) for style in ("thermostat", "chatter", "random")),
    ],
    ids=lambda value: value if isinstance(value, str) else "default" if value is EFFECTS else "hostile",
)
def test_no_fault_is_found_where_there_is_none(style, effects):
    box = drive(SupervisedBox(11, effects), style, minutes=500, seed=12)
    assert box.found == [], f"after {box.minutes} min at {box.air:.1f} °C"


@pytest.mark.parametrize("seed", range(3))
def test_a_dead_heater_is_named_within_a_quarter_of_an_hour_at_full_duty(seed):
    box = SupervisedBox(seed).run(10, 0.0, False)
    box.faults["heater"] = 0.0
    assert box.until_found(1.0, False) <= 15
    assert box.found == [HEATER_NO_EFFECT]


@pytest.mark.parametrize("heated_minutes", [5, 10, 15])
def test_a_heater_that_dies_while_it_heats_is_named_within_35_minutes(heated_minutes):
    box = SupervisedBox(1).run(heated_minutes, 1.0, False)
    box.faults["heater"] = 0.0
    assert box.until_found(1.0, False) <= 35
    assert box.found == [HEATER_NO_EFFECT]


@pytest.mark.parametrize("heated_minutes", [0, 20, 60])
@pytest.mark.parametrize("seed", range(2))
def test_a_relay_stuck_on_is_named_within_25_minutes_below_43_degrees(heated_minutes, seed):
    box = SupervisedBox(seed).run(heated_minutes, 1.0, False)
    box.faults["heater"] = 1.0
    assert box.until_found(0.0, False) <= 25
    assert box.found == [HEATER_STUCK_ON]
    assert box.chamber.truth()["temp_air_c"] < 43.0


@pytest.mark.parametrize("seed", range(2))
def test_with_the_fan_as_answer_a_relay_stuck_on_can_not_overheat_the_box(seed):
    box = SupervisedBox(seed).run(60, 1.0, False)
    box.faults["heater"] = 1.0
    box.run(20, 0.0, True)
    assert box.chamber.truth()["temp_air_c"] < 30.0


@pytest.mark.parametrize("duty", [0.0, 1.0])
def test_a_fan_that_does_not_turn_is_named_in_five_minutes(duty):
    box = SupervisedBox(2).run(60, 1.0, False)
    box.faults["fan"] = 0.0
    assert box.until_found(duty, True) <= 6
    assert box.found == [FAN_NO_EFFECT]


def test_the_fan_that_takes_all_heat_away_is_no_dead_heater():
    assert SupervisedBox(3).run(180, 1.0, True).found == []


def test_a_stuck_fan_that_blows_all_the_time_is_no_false_alarm_of_other_parts():
    box = SupervisedBox(4)
    box.faults["fan"] = 1.0
    assert set(drive(box, "smooth", minutes=400, seed=5).found) <= {HEATER_NO_EFFECT}


# A calibration


def after_calibration(before: Observation, air_k: float, is_shifted: bool) -> tuple[str, float] | None:
    """Look 25 minutes at one state, lift the air's reading, and look on."""
    memory = ThermalMemory()
    for _ in range(25):
        memory, findings = look(memory, before)
        assert findings == ()
    if is_shifted:
        memory = shift_readings(memory, air_k, 0.0)
    return first_trip([replace(before, temp_air=before.temp_air + air_k)] * 60, memory)


def test_a_reading_that_a_calibration_lifts_is_not_heat():
    warm = replace(REST, temp_air=28.0)
    # 3000 J/K * 5 K in 600 s are 25 W, and 4 W/K * 7 K lost are 28 W: more than the 50 W that may come in
    assert after_calibration(warm, 5.0, is_shifted=False)[0] == HEATER_STUCK_ON
    assert after_calibration(warm, 5.0, is_shifted=True) is None


def test_a_reading_that_a_calibration_lowers_hides_no_dead_heater():
    cold = replace(REST, heater_duty=1.0)
    memory, _ = look(ThermalMemory(), cold)
    trip, passed_s = first_trip([replace(cold, temp_air=17.0)] * 60, shift_readings(memory, -4.0, 0.0))
    assert trip == HEATER_NO_EFFECT
    assert passed_s <= 900.0
