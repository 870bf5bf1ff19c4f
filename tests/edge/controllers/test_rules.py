import math

import pytest
from contexts import context

from edge.controllers.rules import Rules
from edge.core.controller import ControlLimits
from edge.core.messages import Command
from edge.core.names import levels_allowed

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
