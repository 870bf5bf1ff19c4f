"""The PID and the rules: directions, limits, windup, and what they do without a temperature."""

import math
from dataclasses import replace

import pytest
from contexts import context
from hypothesis import given
from hypothesis import strategies as st

from edge.controllers.pid import Pid
from edge.controllers.rules import Rules
from edge.core.controller import ControlLimits
from edge.core.messages import Command
from edge.core.names import levels_allowed


def decided(**what):
    return Pid().decide(context(**what)).command


def test_a_cold_box_is_heated_and_a_warm_one_is_not():
    assert decided(temp=24.0, reference=26.0).heater_duty > 0.5
    assert decided(temp=26.5, reference=26.0) == Command()


def test_the_fan_runs_when_the_heater_is_off_and_the_air_far_above():
    assert decided(temp=27.1, reference=26.0).fan_on
    assert not decided(temp=26.9, reference=26.0).fan_on
    assert decided(temp=26.5, reference=26.0, last_sent=Command(fan_on=True)).fan_on
    assert not decided(temp=26.2, reference=26.0, last_sent=Command(fan_on=True)).fan_on


def test_a_held_relay_stays_as_it_is():
    assert not decided(temp=30.0, reference=26.0, limits=ControlLimits(fan_hold_steps=1)).fan_on


@pytest.mark.parametrize("temp", [math.nan, math.inf, -math.inf])
def test_nothing_is_on_without_a_temperature(temp):
    assert decided(temp=temp, reference=26.0) == Command()


def test_the_heater_is_off_at_the_limit_of_the_air():
    assert decided(temp=40.0, reference=45.0, limits=ControlLimits(temp_air_max_c=40.0)).heater_duty == 0.0


def parts(*steps: dict) -> list[tuple[float, float, float]]:
    """Proportional, integral and derivative part after each decision of one PID, a minute apart."""
    pid, found = Pid(kp=0.5, ki=0.0005, kd=80.0), []
    for k, step in enumerate(steps):
        why = pid.decide(context(now_s=60.0 * k, **step)).why
        found.append((why["proportional"], why["integral"], why["derivative"]))
    return found


SENT = Command(heater_duty=0.4)


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        # A takeover begins with the duty sent last; what the error asks for on top is not the integral's.
        ([{"temp": 26.0, "last_sent": SENT}], (0.0, 0.4, 0.0)),
        ([{"temp": 25.5, "last_sent": SENT}], (0.25, 0.15, 0.0)),
        ([{"temp": 24.0, "last_sent": SENT}], (1.0, 0.0, 0.0)),
        ([{"temp": 27.0, "last_sent": Command(heater_duty=0.8)}], (-0.5, 0.8, 0.0)),
        # The integral, 0.0005 / (K s) for a minute, where the output was sent as it was.
        ([{"temp": 25.5, "last_sent": SENT}] * 2, (0.25, 0.165, 0.0)),
        # The integral rises to the duty sent. The filter has 8 s, so D is 80 * 0.5 / (8 + 60).
        ([{"temp": 26.0, "last_sent": SENT}, {"temp": 25.5, "last_sent": SENT}], (0.25, 0.4, 40 / 68)),
        # A step of the reference is no rate of the air.
        ([{"temp": 26.0, "last_sent": SENT}, {"temp": 26.0, "reference": 27.0, "last_sent": SENT}],
         (0.5, 0.4, 0.0)),
        # 0.4 was asked for and nothing sent: back by 60 s of sqrt(80 / 0.0005) = 400 s.
        ([{"temp": 26.0, "last_sent": SENT}, {"temp": 26.0}], (0.0, 0.4 - 0.15 * 0.4, 0.0)),
        # 2.0 was asked for, 1.0 sent: 0.12 of the error less 0.15 of the cut, not below no heat.
        ([{"temp": 22.0}, {"temp": 22.0, "last_sent": Command(heater_duty=1.0)}], (2.0, 0.0, 0.0)),
        # Air above the set point that asks for less than nothing does not raise the integral.
        ([{"temp": 28.0}] * 5, (-1.0, 0.0, 0.0)),
    ],
)  # fmt: skip
def test_each_part_is_the_textbooks(steps, expected):
    assert parts(*steps)[-1] == pytest.approx(expected)


def test_heat_that_was_cut_does_not_wind_up():
    """A heater at its largest duty for three hours leaves no integral behind; simple-pid left all of it."""
    pid, full = Pid(), Command(heater_duty=1.0)
    for k in range(200):
        pid.decide(context(temp=20.0, reference=30.0, now_s=60.0 * k, last_sent=full))
    decision = pid.decide(context(temp=30.0, reference=30.0, now_s=60.0 * 200, last_sent=full))
    assert decision.why["integral"] == 0.0
    assert decision.command.heater_duty == 0.0


def test_the_same_times_give_the_same_commands_however_fast_the_machine():
    def commands():
        pid = Pid()
        return [pid.decide(context(temp=24.0 + 0.1 * k, now_s=60.0 * k)).command for k in range(20)]

    assert commands() == commands()


def test_reset_forgets_the_integral():
    pid, fresh = Pid(), Pid()
    for k in range(20):
        pid.decide(context(temp=24.0, now_s=60.0 * k))
    pid.reset()
    assert pid.decide(context(temp=25.9)).command == fresh.decide(context(temp=25.9)).command


def test_a_long_pause_is_not_integrated_over():
    pid, fresh = Pid(), Pid()
    pid.decide(context(temp=20.0, now_s=0.0))
    late = replace(context(temp=25.9), now_s=4000.0)
    assert pid.decide(late).command == fresh.decide(context(temp=25.9)).command


@given(temp=st.floats(), reference=st.floats(20.0, 38.0), top=st.floats(0.0, 1.0))
def test_every_command_is_one_the_board_takes(temp, reference, top):
    command = decided(temp=temp, reference=reference, limits=ControlLimits(heater_max_duty=top))
    assert 0.0 <= command.heater_duty <= top + 1e-9  # a step of the heater less a rounding error is that step
    assert command.heater_duty * 20 == pytest.approx(round(command.heater_duty * 20))


# the rules


HEATING, COOLING, WAITING = Command(heater_duty=1.0), Command(fan_on=True), Command()
STEP = 1e-6  # the reference is 26: heat on below 25.5, off above 26.5; fan on above 27.5, off below 26


@pytest.mark.parametrize(
    ("temp", "last", "expected"),
    [
        (25.5 - STEP, WAITING, HEATING),
        (25.5, WAITING, WAITING),
        (25.5 + STEP, WAITING, WAITING),
        (26.5 - STEP, HEATING, HEATING),
        (26.5, HEATING, WAITING),
        (26.5 + STEP, HEATING, WAITING),
        (27.5, WAITING, WAITING),
        (27.5 + STEP, WAITING, COOLING),
        (26.0 + STEP, COOLING, COOLING),
        (26.0, COOLING, WAITING),
        (26.0 - STEP, COOLING, WAITING),
        (-math.inf, WAITING, HEATING),
        (math.inf, HEATING, COOLING),
        (math.nan, HEATING, WAITING),
        (math.nan, COOLING, WAITING),
    ],
)
def test_the_edges_of_the_bands(temp, last, expected):
    assert Rules().decide(context(temp, last_sent=last)).command == expected


def test_an_unknown_reference_turns_all_off():
    decision = Rules().decide(context(20.0, math.nan, HEATING))
    assert decision.command == WAITING
    assert "unknown" in decision.why["rule"]


@pytest.mark.parametrize(
    ("most", "duty"),
    [(1.0, 1.0), (0.5, 0.5), (0.57, 0.55), (0.04, 0.0), (0.0, 0.0), (math.nan, 0.0), (-1.0, 0.0)],
)
def test_the_heater_keeps_its_cap(most, duty):
    assert (
        Rules().decide(context(20.0, limits=ControlLimits(heater_max_duty=most))).command.heater_duty == duty
    )


@pytest.mark.parametrize("limit", [24.0, 23.0, math.nan])
def test_nothing_heats_at_or_above_the_temperature_limit(limit):
    decision = Rules().decide(context(24.0, 30.0, HEATING, ControlLimits(temp_air_max_c=limit)))
    assert decision.command.heater_duty == 0.0


@pytest.mark.parametrize("was_on", [True, False])
def test_a_held_fan_is_left_alone(was_on):
    for temp in (20.0, 26.0, 40.0, math.nan):
        last = Command(fan_on=was_on)
        decision = Rules().decide(context(temp, last_sent=last, limits=ControlLimits(fan_hold_steps=1)))
        assert decision.command.fan_on is was_on


@pytest.mark.parametrize(
    ("duty", "levels"),
    [(0.05 * k, k) for k in range(21)] + [(0.0499, 0), (2.0, 20), (math.inf, 20), (-0.1, 0), (math.nan, 0)],
)
def test_a_duty_allows_the_levels_up_to_it(duty, levels):
    assert levels_allowed(duty) == levels
