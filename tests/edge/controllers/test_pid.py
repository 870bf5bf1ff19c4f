"""The PID: directions, limits, windup, and what it does without a temperature."""

import math
from dataclasses import replace

import pytest
from contexts import context
from hypothesis import given
from hypothesis import strategies as st

from edge.controllers.pid import Pid
from edge.core.controller import ControlLimits
from edge.core.messages import Command


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


def test_the_integral_does_not_wind_up():
    pid = Pid()
    for k in range(200):
        pid.decide(context(temp=20.0, reference=30.0, now_s=60.0 * k))
    why = pid.decide(context(temp=30.0, reference=30.0, now_s=60.0 * 200)).why
    assert 0.0 <= why["integral"] <= 1.0


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
