"""edge/tick/orders.py: what a person may ask, what it does to a command, and its words."""

import math
from dataclasses import replace

import pytest

from edge.core.errors import DataError, RequestError
from edge.core.messages import Command
from edge.tick import steering as steerings
from edge.tick.calibration import CalibrationPoint, StandingCalibration
from edge.tick.order_words import order_words
from edge.tick.orders import ORDERS, Desk, FanMode, Mode, Operation, apply_orders, operate, with_author
from edge.tick.orders_json import from_dict, to_dict
from edge.tick.standing_profile import StandingProfile
from edge.tick.steering import DailyTarget, FanRest, Steering

DESK = Desk(utc=1000.0, controllers=("MPC", "rules"), reference_min_c=15.0, reference_max_c=38.0)
AUTO = Operation(controller="MPC")
NIGHT = Steering(
    id="a",
    words="20 at night, spare the fan",
    until_utc=1000.0 + 3600.0,
    daily=(DailyTarget(6 * 3600.0, 26.0), DailyTarget(22 * 3600.0, 20.0)),
    fan_penalty=5.0,
    fan_rest=(FanRest(22 * 3600.0, 6 * 3600.0),),
)
WANTED = Command(heater_duty=0.4, fan_on=True, led=0.5)


def ask(**request: object) -> Operation:
    return operate(AUTO, request, DESK)


def test_auto_leaves_the_controllers_command_alone() -> None:
    assert apply_orders(AUTO, WANTED) == (WANTED, ())


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        (Mode.HEAT, Command(0.4, False, 0.5)),
        (Mode.FAN_ONLY, Command(0.0, True, 0.5)),
        (Mode.OFF, Command(0.0, False, 0.5)),
    ],
)
def test_a_mode_takes_away_what_it_does_not_allow(mode: Mode, expected: Command) -> None:
    sent, changes = apply_orders(Operation("MPC", mode=mode), WANTED)
    assert sent == expected
    assert {change.rule for change in changes} == {"operator.orders"}


def test_manual_sends_the_persons_command_whatever_the_controller_wants() -> None:
    operation = ask(do="set_manual", heater_duty=0.52, fan_on=0)
    sent, _ = apply_orders(operation, WANTED)
    assert operation.mode is Mode.MANUAL
    assert sent == Command(0.5, False, 0.0)  # 0.52 is cut to the next lower twentieth


@pytest.mark.parametrize("fan_mode", [FanMode.ON, FanMode.OFF])
def test_the_fan_switch_overrules_the_controller(fan_mode: FanMode) -> None:
    sent, _ = apply_orders(Operation("MPC", fan_mode=fan_mode), Command())
    assert sent.fan_on is (fan_mode is FanMode.ON)


@pytest.mark.parametrize("value", [None, "26", True, math.nan, math.inf, -math.inf, 14.99, 38.01, [26], {}])
def test_a_reference_that_is_no_number_in_range_is_refused(value: object) -> None:
    if value is None:
        assert ask(do="set_reference", reference_c=None).reference_c is None
        return
    with pytest.raises(RequestError, match="reference_c"):
        ask(do="set_reference", reference_c=value)


@pytest.mark.parametrize("value", [15, 15.0, 26.5, 38.0])
def test_a_reference_at_or_inside_the_limits_is_taken(value: float) -> None:
    assert ask(do="set_reference", reference_c=value).reference_c == value


@pytest.mark.parametrize("duty", [-0.01, 1.01, math.nan, "1", None, True])
def test_a_manual_duty_outside_0_to_1_is_refused(duty: object) -> None:
    with pytest.raises(RequestError, match="heater_duty"):
        ask(do="set_manual", heater_duty=duty)


def test_an_unknown_controller_is_refused_with_the_known_ones() -> None:
    with pytest.raises(RequestError, match="MPC, rules"):
        ask(do="set_controller", name="PID")


def test_an_unknown_request_names_the_nearest() -> None:
    with pytest.raises(RequestError, match="did you mean 'set_mode'"):
        ask(do="set_mod")
    for junk in (None, 5, [], {}):
        with pytest.raises(RequestError, match="unknown request"):
            ask(do=junk)


@pytest.mark.parametrize("minutes", [30, 24 * 60])
def test_maintenance_expires_by_itself(minutes: int) -> None:
    operation = ask(do="maintenance", minutes=minutes)
    assert operation.in_maintenance(1000.0)
    assert operation.in_maintenance(1000.0 + 60.0 * minutes - 1.0)
    assert not operation.in_maintenance(1000.0 + 60.0 * minutes)


def test_a_clock_that_lost_the_date_does_not_end_maintenance() -> None:
    operation = ask(do="maintenance", minutes=30)
    assert operation.in_maintenance(1000.0 - 10 * 86400.0)


@pytest.mark.parametrize("minutes", [-1, 1440.1, 1441, math.nan, "30", None])
def test_maintenance_of_no_sane_length_is_refused(minutes: object) -> None:
    with pytest.raises(RequestError, match="minutes"):
        ask(do="maintenance", minutes=minutes)


def test_zero_minutes_end_maintenance() -> None:
    assert operate(ask(do="maintenance", minutes=5), {"do": "maintenance", "minutes": 0}, DESK) == AUTO


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"daily": [{"from_s": 0.0, "reference_c": 60.0}]}, "outside 15 to 38"),
        ({"until_utc": 4e9}, "within the next 168 h"),
        ({"fan_penalty": "5"}, "must be a number, not '5'"),
        ({"heater_max_duty": 2.0}, "heater_max_duty"),
    ],
)
def test_steering_past_the_desk_is_held_to_the_same_limits(changed: dict[str, object], said: str) -> None:
    with pytest.raises(RequestError, match=said):
        ask(do="steer", steering={**steerings.to_dict(NIGHT), **changed})


def test_orders_survive_the_state_file() -> None:
    operation = AUTO
    for request in (
        {"do": "set_mode", "mode": "heat"},
        {"do": "set_fan_mode", "fan_mode": "on"},
        {"do": "set_reference", "reference_c": 26.0},
        {"do": "set_controller", "name": "rules"},
        {"do": "set_manual", "heater_duty": 0.25, "led": 1.0},
        {"do": "emergency_stop"},
        {"do": "maintenance", "minutes": 3},
        {"do": "steer", "steering": steerings.to_dict(NIGHT)},
        {"do": "steer", "steering": steerings.to_dict(replace(NIGHT, id="b", daily=()))},
    ):
        operation = operate(operation, request, DESK)
        assert from_dict(to_dict(operation)) == operation
    assert operation.emergency_stop


@pytest.mark.parametrize("key", sorted(to_dict(AUTO).keys() - {"steering", "before"}))
def test_a_state_with_a_missing_key_is_told(key: str) -> None:
    values = to_dict(AUTO)
    del values[key]
    with pytest.raises(DataError, match=f"operation.{key}: missing"):
        from_dict(values)


def test_every_order_has_a_test_of_its_effect() -> None:
    changed = {
        "set_mode": {"mode": "off"},
        "set_fan_mode": {"fan_mode": "off"},
        "set_reference": {"reference_c": 20.0},
        "set_controller": {"name": "rules"},
        "set_manual": {"heater_duty": 1.0},
        "emergency_stop": {},
        "maintenance": {"minutes": 1},
        "steer": {"steering": steerings.to_dict(NIGHT)},
        "start_profile": {"profile": {"name": "a", "times_s": [0.0], "targets_c": [25.0]}},
    }
    for name, values in changed.items():
        assert ask(do=name, **values) != AUTO
    stopped = ask(do="emergency_stop")
    assert operate(stopped, {"do": "release_emergency_stop"}, DESK) == AUTO
    assert operate(ask(do="steer", steering=steerings.to_dict(NIGHT)), {"do": "undo"}, DESK) == AUTO
    # The orders to a profile that is followed: test_standing_profile.py; about sensors: test_calibration.py
    followed = {"pause_profile", "resume_profile", "skip_profile", "end_profile"}
    sensors = {"calibrate_point", "discard_points", "apply_calibration", "reset_calibration"}
    assert set(ORDERS) == {*changed, *followed, *sensors, "release_emergency_stop", "undo"}


def test_the_controller_none_is_the_configured_one():
    desk = Desk(0.0, ("MPC", "PID"), 10.0, 35.0, configured_controller="MPC")
    changed = operate(Operation(controller="PID"), {"do": "set_controller", "name": None}, desk)
    assert changed.controller == "MPC"
    with pytest.raises(RequestError):
        operate(changed, {"do": "set_controller"}, desk)


# in words

NIGHT_PROFILE = StandingProfile("night", (0.0, 7200.0), (20.0, 24.0))
PAUSED = replace(NIGHT_PROFILE, is_paused=True)
STOPPED, HANDS_IN = replace(AUTO, emergency_stop=True), replace(AUTO, maintenance_until_utc=2800.0)
HANDS_OUT = replace(AUTO, maintenance_until_utc=1000.0)
BY_HAND, PLAYING = replace(AUTO, reference_c=30.0), replace(AUTO, profile=NIGHT_PROFILE)
POINT = CalibrationPoint("co2", 425.0, 410.0, 2.0, 900.0)
MEASURED = replace(AUTO, points=(POINT,))
CALIBRATED = replace(AUTO, calibrations=(StandingCalibration("co2", 1.0, 15.0, 1000.0),))
STOP_HOLDS = "the emergency stop holds everything off until it is released."
HANDS_HOLD = "Maintenance holds everything off for another 30 min; `greenhouse maintenance 0` ends it."
CONTROLS = "MPC controls the heater and the fan."
CHANGED = [  # order, before, after, message
    ("emergency_stop", AUTO, STOPPED, "Emergency stop: everything is off until it is released."),
    ("release_emergency_stop", STOPPED, AUTO, "The emergency stop is released."),
    (
        "release_emergency_stop",
        replace(HANDS_IN, emergency_stop=True),
        HANDS_IN,
        f"The emergency stop is released. {HANDS_HOLD}",
    ),
    ("maintenance", AUTO, HANDS_IN, "Maintenance: everything is off for 30 min."),
    ("maintenance", HANDS_IN, AUTO, "Maintenance is over."),
    ("set_reference", AUTO, BY_HAND, "Holding 30.0 °C by hand."),
    ("set_reference", AUTO, replace(AUTO, reference_c=26.25), "Holding 26.25 °C by hand."),
    ("set_reference", BY_HAND, AUTO, "Holding the configured set point."),
    (
        "set_reference",
        replace(PLAYING, reference_c=30.0),
        PLAYING,
        "Following the profile night, 0 min of 2 h 0 min.",
    ),
    (
        "set_reference",
        PLAYING,
        replace(PLAYING, reference_c=30.0),
        'Holding 30.0 °C by hand. The profile "night" runs on meanwhile.',
    ),
    (
        "set_reference",
        replace(AUTO, profile=PAUSED),
        replace(BY_HAND, profile=PAUSED),
        'Holding 30.0 °C by hand. The profile "night" is paused.',
    ),
    (
        "set_reference",
        STOPPED,
        replace(STOPPED, reference_c=30.0),
        f"Set to 30.0 °C by hand. T{STOP_HOLDS[1:]}",
    ),
    (
        "set_reference",
        replace(AUTO, mode=Mode.OFF),
        replace(BY_HAND, mode=Mode.OFF),
        "Set to 30.0 °C by hand. In mode off, heater and fan stay off, and the controller MPC waits.",
    ),
    (
        "pause_profile",
        PLAYING,
        replace(AUTO, profile=PAUSED),
        "Following the profile night, paused at 0 min of 2 h 0 min.",
    ),
    ("end_profile", PLAYING, AUTO, "Holding the configured set point."),
    ("set_mode", replace(AUTO, mode=Mode.OFF), AUTO, f"In mode auto, {CONTROLS}"),
    (
        "set_mode",
        AUTO,
        replace(AUTO, mode=Mode.HEAT),
        "In mode heat, MPC controls the heater, and the fan stays off.",
    ),
    (
        "set_mode",
        AUTO,
        replace(AUTO, mode=Mode.FAN_ONLY),
        "In mode fan_only, MPC controls the fan, and the heater stays off.",
    ),
    (
        "set_fan_mode",
        AUTO,
        replace(AUTO, fan_mode=FanMode.ON),
        "In mode auto, MPC controls the heater, and the fan stays on.",
    ),
    (
        "set_fan_mode",
        replace(AUTO, mode=Mode.FAN_ONLY),
        replace(AUTO, mode=Mode.FAN_ONLY, fan_mode=FanMode.ON),
        "In mode fan_only, the heater stays off, and the fan stays on.",
    ),
    (
        "set_manual",
        AUTO,
        replace(AUTO, mode=Mode.MANUAL, manual=Command(0.5, True, 0.0)),
        "In mode manual, the heater is at 0.50, the fan is on and the light at 0.00.",
    ),
    ("set_controller", AUTO, Operation("PID"), "In mode auto, PID controls the heater and the fan."),
    (
        "steer",
        AUTO,
        replace(AUTO, steering=NIGHT),
        "As confirmed in words: 20 at night, spare the fan.",
    ),
    (
        "undo",
        replace(AUTO, steering=NIGHT),
        AUTO,
        "Holding the configured set point. What was confirmed in words is undone.",
    ),
    ("calibrate_point", AUTO, MEASURED, "Calibrated by hand: no sensor. Points to apply: co2 425 ppm."),
    ("discard_points", MEASURED, AUTO, "Calibrated by hand: no sensor. Points to apply: none."),
    ("apply_calibration", MEASURED, CALIBRATED, "Calibrated by hand: co2. Points to apply: none."),
    ("reset_calibration", CALIBRATED, AUTO, "Calibrated by hand: no sensor. Points to apply: none."),
]
UNCHANGED = [  # order, what holds, before and after, message
    ("emergency_stop", STOPPED, STOP_HOLDS),
    ("release_emergency_stop", AUTO, "there is no emergency stop."),
    ("release_emergency_stop", HANDS_IN, f"there is no emergency stop. {HANDS_HOLD}"),
    ("maintenance", AUTO, "there is no maintenance."),
    ("maintenance", HANDS_OUT, "there is no maintenance."),
    ("maintenance", HANDS_IN, HANDS_HOLD.replace("M", "m", 1)),
    ("set_mode", AUTO, f"in mode auto, {CONTROLS}"),
    ("set_controller", AUTO, f"in mode auto, {CONTROLS}"),
    ("set_reference", BY_HAND, "holding 30.0 °C by hand."),
    ("resume_profile", PLAYING, "following the profile night, 0 min of 2 h 0 min."),
]


@pytest.mark.parametrize(("kind", "before", "after", "message"), CHANGED)
def test_an_order_is_answered_with_what_holds_now(
    kind: str, before: Operation, after: Operation, message: str
) -> None:
    assert order_words(kind, before, after, DESK.utc) == (True, message)


@pytest.mark.parametrize(("kind", "holds", "message"), UNCHANGED)
def test_an_order_that_changes_nothing_says_what_holds_already(
    kind: str, holds: Operation, message: str
) -> None:
    assert order_words(kind, holds, holds, DESK.utc) == (False, f"Nothing changed: {message}")


def test_maintenance_whose_time_is_over_is_shown_nowhere() -> None:
    assert HANDS_IN.at(2799.0) == HANDS_IN
    assert HANDS_IN.at(2800.0) == AUTO == HANDS_OUT.at(DESK.utc)
    assert order_words("maintenance", HANDS_OUT, AUTO, DESK.utc)[0] is False


def test_every_kind_of_order_has_its_words() -> None:
    covered = {kind for kind, *_ in (*CHANGED, *UNCHANGED)}
    assert set(ORDERS) - covered == {"start_profile", "skip_profile"}  # say what `end_profile` and others say


@pytest.mark.parametrize(
    ("text", "said"),
    [("Maintenance is over.", "Maintenance is over. Ordered by Ann."), ("adopted", "adopted, by Ann")],
)
def test_an_author_stands_beside_what_they_did(text: str, said: str) -> None:
    assert (with_author(text, {"by": "Ann"}), with_author(text, {})) == (said, text)
