"""A steering at work: what it makes of the reference, of the limits to plan in, and of a command."""

import math
from dataclasses import replace

import numpy as np

from edge.core.controller import ControlLimits, Penalty
from edge.core.messages import Command
from edge.core.names import HEATER_LEVELS
from edge.tick.reference import Reference
from edge.tick.steering import Steering


def reference_of(steering: Steering) -> Reference | None:
    """Return the reference over the day, None where the request has none."""
    if not steering.daily:
        return None
    times = np.array([target.from_s for target in steering.daily])
    return Reference(times, np.array([target.reference_c for target in steering.daily]), daily=True)


def in_force(by_hand_c: float | None, steering: Steering | None, configured: Reference) -> Reference:
    """Return the reference in force: a temperature set by hand, else the
    request's, else the configured one.
    """
    if by_hand_c is not None:
        return Reference(np.zeros(1), np.array([by_hand_c]))
    asked = None if steering is None else reference_of(steering)
    return asked or configured


def limit(
    limits: ControlLimits, steering: Steering, since_midnight_s: float, step_s: float, fan_on: bool
) -> ControlLimits:
    """Return the limits for a controller that plans; a rest of the fan looks like a relay that must hold."""
    duty = limits.heater_max_duty
    if steering.heater_max_duty is not None:
        duty = min(duty, steering.heater_max_duty)
    rest_s = 0.0 if fan_on else steering.rest_left_s(since_midnight_s)
    hold = max(limits.fan_hold_steps, math.ceil(rest_s / step_s))
    return replace(limits, heater_max_duty=duty, fan_hold_steps=hold)


def penalty_of(steering: Steering) -> Penalty:
    """Return the requested weights."""
    return Penalty(steering.heater_penalty, steering.fan_penalty)


def steer(command: Command, steering: Steering, since_midnight_s: float) -> Command:
    """Return the command as far as the operator's constraints allow it."""
    if steering.heater_max_duty is not None and not command.heater_duty <= steering.heater_max_duty:
        command = replace(command, heater_duty=_level_below(steering.heater_max_duty))
    if command.fan_on and steering.rest_left_s(since_midnight_s) > 0.0:
        command = replace(command, fan_on=False)
    return command


def _level_below(duty: float) -> float:
    return math.floor(duty * HEATER_LEVELS + 1e-9) / HEATER_LEVELS
