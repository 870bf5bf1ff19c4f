"""Predicted effect of a steering over the next day: the twin with the same planner, with and without it.

The planner is a plain one: at each step it takes, of the 42 pairs of heater level and fan, the one that costs
least over the next ten (the paper's stage cost), the heater held and the fan for this step alone, since a few
minutes of it cool the box down to the room. So two courses differ by what was asked for and not by the
controller in use, and a day takes a second or two.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.core.names import HEATER_LEVELS, HEATER_MAX_W
from edge.tick.reference import DAY_S, Reference
from edge.tick.steering import Steering
from edge.twin.model import BoxTwin
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
LOOK_STEPS = 10
NEAR_K = 0.5  # the sensor's class
_DUTY = np.tile(np.arange(HEATER_LEVELS + 1) / HEATER_LEVELS, 2)  # of the 42 pairs
_FAN = np.repeat([0.0, 1.0], HEATER_LEVELS + 1)


@dataclass(frozen=True, slots=True)
class DayStart:
    """The start of the day. The ambient is assumed to stay constant."""

    temp_air: float
    temp_ambient: float
    since_start_s: float  # of the configured reference's own axis
    since_midnight_s: float


@dataclass(frozen=True, slots=True)
class PlannerGoal:
    """The planner's goal.

    heater_penalty, fan_penalty : weights of the stage cost
    steering : its constraints hold, None for none
    """

    reference: Reference
    heater_penalty: float
    fan_penalty: float
    heater_max_duty: float
    steering: Steering | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PredictedDay:
    """A day, a row per step: air and reference at its end [°C], heater duty and fan in it; all [N]."""

    temps: Floats
    reference: Floats
    duty: Floats
    fan: Floats
    step_s: float

    def figures(self) -> dict[str, Any]:
        """JSON values, units in the keys."""
        errors = np.abs(self.temps - self.reference)
        return {
            "temp_air_low_c": round(float(self.temps.min()), 1),
            "temp_air_high_c": round(float(self.temps.max()), 1),
            "mean_error_k": round(float(errors.mean()), 2),
            "within_half_a_degree_pct": round(100.0 * float((errors < NEAR_K).mean())),
            "heat_wh": round(float(self.duty.sum()) * HEATER_MAX_W * self.step_s / 3600.0),
            "fan_min": round(float(self.fan.sum()) * self.step_s / 60.0),
        }


def coming_day(twin: BoxTwin, now: DayStart, wanted: PlannerGoal) -> PredictedDay:
    """Predict the next 24 hours. Errors: DataError for a twin that needs more than the ambient temperature"""
    steps = round(DAY_S / twin.step_s)
    offsets: Floats = twin.step_s * np.arange(steps + LOOK_STEPS, dtype=np.float64)
    clock = now.since_midnight_s + offsets
    reference = wanted.reference.at(now.since_start_s + offsets, clock)
    state = at_rest(twin, now.temp_air, now.temp_ambient)
    temps, chosen = np.empty(steps), np.empty((steps, 2))
    for k in range(steps):
        ahead = reference[k : k + LOOK_STEPS]
        chosen[k] = _cheapest(twin, state, now.temp_ambient, ahead, wanted, float(clock[k]))
        state = twin.advance(state, now.temp_ambient, *chosen[k])
        temps[k] = state[0]
    return PredictedDay(temps, reference[:steps], chosen[:, 0], chosen[:, 1], twin.step_s)


def _cheapest(
    twin: BoxTwin, state: Floats, ambient: float, reference: Floats, wanted: PlannerGoal, clock_s: float
) -> tuple[float, float]:
    """Heater duty and fan of this step that cost least."""
    allowed = _allowed_levels(wanted, clock_s)
    duty, fan = _DUTY[allowed], _FAN[allowed]
    states = np.broadcast_to(state, (len(duty), len(state)))
    cost = len(reference) * wanted.heater_penalty * duty**2 + wanted.fan_penalty * fan
    for k, target in enumerate(reference):
        states = twin.advance(states, ambient, duty, fan if k == 0 else np.zeros(len(fan)))
        cost = cost + TRACKING_WEIGHT * (states[:, 0] - target) ** 2
    best = int(cost.argmin())
    return float(duty[best]), float(fan[best])


def _allowed_levels(wanted: PlannerGoal, clock_s: float) -> NDArray[np.bool_]:
    steering, duty_max = wanted.steering, wanted.heater_max_duty
    allowed: NDArray[np.bool_] = np.ones(len(_DUTY), dtype=bool)
    if steering is not None:
        duty_max = duty_max if steering.heater_max_duty is None else min(duty_max, steering.heater_max_duty)
        if steering.rest_left_s(clock_s) > 0.0:
            allowed &= _FAN == 0.0
    allowed &= (duty_max >= _DUTY) | (_DUTY == 0.0)
    return allowed
