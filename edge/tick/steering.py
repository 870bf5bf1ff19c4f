"""An operator's request in words, as values: a reference by the clock, penalties, constraints, an end.

It never reaches the board: it changes what the controller is asked for, and the fan's rest is an order like
the operating mode's. Safety stands behind both.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from edge.core.controller import ControlLimits, Penalty
from edge.core.messages import Command
from edge.core.names import HEATER_LEVELS
from edge.core.plain_text import plain
from edge.formats.cross_check import REQUIRED
from edge.formats.reader import read
from edge.tick.reference import Reference

DAY_S = 86400.0
HOURS_MAX = 168.0  # a wish that holds for longer than a week belongs into edge.yaml
PENALTY_MAX = 100.0
WORDS_MAX = 500  # of an operator [characters]


@dataclass(frozen=True, slots=True)
class DailyTarget:
    """From local time `from_s` [s since midnight] on, every day: `reference_c` [°C]."""

    from_s: float
    reference_c: float


@dataclass(frozen=True, slots=True)
class FanRest:
    """The fan stays off between two local times [s since midnight]; over midnight where until is first."""

    from_s: float
    until_s: float

    def left_s(self, since_midnight_s: float) -> float:
        """How long it still lasts [s]; 0 outside it."""
        length = (self.until_s - self.from_s) % DAY_S
        gone = (since_midnight_s - self.from_s) % DAY_S
        return length - gone if gone < length else 0.0


@dataclass(frozen=True, slots=True)
class Steering:
    """Standing until `until_utc`; what is None or empty stays as it is configured.

    words : the operator's own
    heater_penalty, fan_penalty : weights in the cost of controllers that plan (MPC-P has 1), told to an LLM
    """

    id: str
    words: str
    until_utc: float
    daily: tuple[DailyTarget, ...] = field(default=(), metadata=REQUIRED)
    heater_penalty: float | None = field(default=None, metadata=REQUIRED)
    fan_penalty: float | None = field(default=None, metadata=REQUIRED)
    heater_max_duty: float | None = field(default=None, metadata=REQUIRED)
    fan_rest: tuple[FanRest, ...] = field(default=(), metadata=REQUIRED)

    def rest_left_s(self, since_midnight_s: float) -> float:
        """How long the fan has to stay off from now on [s]; 0 where it may run."""
        return max((rest.left_s(since_midnight_s) for rest in self.fan_rest), default=0.0)


def problem(steering: Steering, now_utc: float, min_c: float, max_c: float) -> str:
    """Return why an operator may not request this, "" where everything is allowed."""
    if not now_utc < steering.until_utc <= now_utc + 3600.0 * HOURS_MAX:
        return f"until: has to lie within the next {HOURS_MAX:g} h"
    for target in steering.daily:
        if not (min_c <= target.reference_c <= max_c and 0.0 <= target.from_s < DAY_S):
            return f"reference: {target.reference_c:g} °C is outside {min_c:g} to {max_c:g} °C"
    for name, value in (("heater", steering.heater_penalty), ("fan", steering.fan_penalty)):
        if value is not None and not 0.0 <= value <= PENALTY_MAX:
            return f"{name}_penalty: {value:g} is not from 0 to {PENALTY_MAX:g}"
    duty = steering.heater_max_duty
    if duty is not None and not 0.0 <= duty <= 1.0:
        return f"heater_max_duty: {duty:g} is not from 0 to 1"
    return ""


def to_dict(steering: Steering) -> dict[str, Any]:
    """JSON values."""
    values = asdict(steering)
    return {**values, "daily": list(values["daily"]), "fan_rest": list(values["fan_rest"])}


def from_dict(values: Mapping[str, Any]) -> Steering:
    """Invert `to_dict`. Errors: DataError on values it never wrote"""
    found = read(Steering, values, key="steering")
    return replace(found, id=plain(found.id, 40), words=plain(found.words, WORDS_MAX))


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
        command = replace(command, heater_duty=level_below(steering.heater_max_duty))
    if command.fan_on and steering.rest_left_s(since_midnight_s) > 0.0:
        command = replace(command, fan_on=False)
    return command


def level_below(duty: float) -> float:
    """Return the highest level of the heater that is not above `duty` [0..1]."""
    return math.floor(duty * HEATER_LEVELS + 1e-9) / HEATER_LEVELS
