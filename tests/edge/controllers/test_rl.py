"""The controllers RL-*: a policy's choice among what safety allows, and what it tells of it."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from contexts import context
from hypothesis import given
from hypothesis import strategies as st
from policy_files import policy_file

from edge.app.controllers import ControllerParts, make
from edge.config.settings import ControlSettings
from edge.controllers.rl import Rl
from edge.core.controller import ControlLimits
from edge.core.controller_names import CONTROLLERS, RL
from edge.core.errors import DataError, RequestError
from edge.core.messages import Command
from edge.core.names import HEATER_LEVELS
from edge.models.arx_file import read_arx
from edge.models.onnx_policy import read_policy
from edge.models.policy_actions import (
    ACTIONS,
    LEVELS,
    action_of,
    allowed_actions,
    command_of,
    duties_and_fans,
)
from edge.models.policy_observation import NAMES


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return read_policy(policy_file(tmp_path_factory.mktemp("policy") / "rl-off.onnx"), "RL-Off")


# actions


def test_there_is_an_action_for_each_level_with_the_fan_off_and_on():
    commands = [command_of(action) for action in range(ACTIONS)]
    assert len({(command.heater_duty, command.fan_on) for command in commands}) == ACTIONS == 42
    assert (commands[0], commands[-1]) == (Command(), Command(heater_duty=1.0, fan_on=True))


def test_an_action_is_the_action_of_its_command():
    assert [action_of(command_of(action)) for action in range(ACTIONS)] == list(range(ACTIONS))
    duty, fan = duties_and_fans(np.arange(ACTIONS))
    assert [Command(heater_duty=d, fan_on=bool(f)) for d, f in zip(duty, fan, strict=True)] == [
        command_of(action) for action in range(ACTIONS)
    ]


@given(max_duty=st.floats(allow_nan=True), hold=st.integers(0, 3), fan_on=st.booleans())
def test_what_is_allowed_is_within_the_limits_and_never_nothing(max_duty, hold, fan_on):
    free = allowed_actions(
        ControlLimits(heater_max_duty=max_duty, fan_hold_steps=hold), Command(fan_on=fan_on)
    )
    assert free.any()
    for action in np.flatnonzero(free):
        command = command_of(int(action))
        assert command.heater_duty == 0.0 or command.heater_duty <= max_duty + 1e-9
        assert hold == 0 or command.fan_on == fan_on


# controllers


def test_the_allowed_action_of_the_highest_value_is_taken(policy):
    decision = Rl("RL-Off", policy).decide(context(24.0, 26.0))
    assert decision.command == command_of(7)
    assert decision.controller == "RL-Off"


def test_limits_leave_the_best_of_what_remains(policy):
    here = context(24.0, 26.0, limits=ControlLimits(heater_max_duty=0.3, fan_hold_steps=1))
    assert Rl("RL-Off", policy).decide(here).command == Command(heater_duty=0.3)  # 7 would be 0.35


def test_with_the_heater_barred_the_fan_can_still_be_chosen(policy):
    here = context(24.0, 26.0, limits=ControlLimits(heater_max_duty=0.0))
    assert Rl("RL-Off", policy).decide(here).command == command_of(LEVELS)


def test_of_equal_values_the_first_action_is_taken(policy):
    assert Rl("RL-Off", policy).decide(context(26.0, 26.0)).command == Command()  # all are worth 0


def test_a_decision_says_why(policy):
    decision = Rl("RL-Off", policy).decide(context(24.0, 26.0))
    why = json.loads(json.dumps(decision.why, allow_nan=False))
    assert why["value"] == pytest.approx(0.4 * 100.07, abs=1e-4)  # an error of 2 K is 0.4 of its scale
    assert why["runner_up"]["heater_duty"] == 1.0
    assert why["margin"] == pytest.approx(0.4 * (100.07 - 0.41), abs=1e-4)
    assert [option["heater_duty"] for option in why["best"]] == [0.35, 1.0, 0.95, 0.9, 0.85]
    assert list(why["observation"]) == list(NAMES)
    assert why["observation"]["error"] == 2.0
    assert why["policy"] == f"RL-Off {policy.version}"
    assert why["forbidden"] == 0


def test_one_action_left_has_no_runner_up(policy):
    here = context(24.0, 26.0, limits=ControlLimits(heater_max_duty=0.0, fan_hold_steps=1))
    why = Rl("RL-Off", policy).decide(here).why
    assert (why["runner_up"], why["margin"], why["forbidden"]) == (None, None, ACTIONS - 1)


def test_without_a_policy_none_is_made():
    with pytest.raises(RequestError, match="RL-Tr-P needs a model that is missing here"):
        make("RL-Tr-P", ControllerParts(ControlSettings(), read_arx()))


def test_an_unknown_temperature_is_refused(policy):
    here = context()
    here.history["temp_air"][-1] = math.nan
    with pytest.raises(DataError, match="observation"):
        Rl("RL-Off", policy).decide(here)


def test_values_that_are_no_numbers_are_refused(policy):
    class Broken:
        name, version = "RL-Off", "broken"

        def values(self, observations):
            return np.full((1, ACTIONS), np.nan)

    with pytest.raises(DataError, match="not numbers"):
        Rl("RL-Off", Broken()).decide(context())


@pytest.mark.parametrize("name", RL)
def test_each_name_is_made_with_its_own_policy(name, policy):
    assert name in CONTROLLERS
    controller = make(name, ControllerParts(ControlSettings(), read_arx(), policies={name: policy}))
    assert controller.name == name
    assert controller.decide(replace(context(24.0, 26.0))).controller == name


@pytest.mark.parametrize("duty", [level / HEATER_LEVELS for level in range(LEVELS)])
def test_a_limit_on_a_level_allows_that_level(duty):
    free = allowed_actions(ControlLimits(heater_max_duty=duty), Command())
    assert max(command_of(int(action)).heater_duty for action in np.flatnonzero(free)) == duty
