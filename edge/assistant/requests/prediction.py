"""Predicted effect of a steering over the next day: the same planner on the twin, with and without it.

The planner is a plain one: at each step it takes, of the 42 pairs of heater level and fan, the one that costs
least over the next ten (the paper's stage cost), the heater held and the fan for this step alone, since a few
minutes of it cool the box down to the room. So two courses differ by what was asked for and not by the
controller in use, and a day takes a second or two.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, tzinfo
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.config.settings import Settings
from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.core.errors import DataError
from edge.core.names import HEATER_LEVELS
from edge.tick.reference import DAY_S, Reference, make_reference, seconds_of_day, zone_of
from edge.tick.standing_profile import profile_of
from edge.tick.steering import Steering, in_force, reference_of
from edge.tick.steering import from_dict as steering_from_dict
from edge.twin.model import BoxTwin
from edge.twin.warm_start import at_rest

_ROWS = {
    "temp_air_low_c": ("lowest air temperature", "°C"),
    "temp_air_high_c": ("highest air temperature", "°C"),
    "mean_error_k": ("mean error from its reference", "K"),
    "within_half_a_degree_pct": ("time within 0.5 K", "%"),
    "heat_wh": ("heat", "Wh"),
    "fan_min": ("fan", "min"),
}


def describe(steering: Steering, zone: tzinfo | None) -> list[str]:
    """One line for each thing that it changes, and its end."""
    return list(_lines(steering, zone))


def _lines(steering: Steering, zone: tzinfo | None) -> Iterator[str]:
    if steering.daily:
        targets = [f"{target.reference_c:g} °C from {_clock(target.from_s)}" for target in steering.daily]
        yield f"reference every day: {', '.join(targets)}"
    for what, penalty in (("heater", steering.heater_penalty), ("fan", steering.fan_penalty)):
        if penalty is not None:
            yield f"penalty of the {what}: {penalty:g}, for MPC-* and LLM-* (MPC-P has 1, MPC 0)"
    if steering.heater_max_duty is not None:
        yield f"heater duty at most {steering.heater_max_duty:g}"
    for rest in steering.fan_rest:
        yield f"fan off from {_clock(rest.from_s)} to {_clock(rest.until_s)}, unless safety needs it"
    until = datetime.fromtimestamp(steering.until_utc, zone)
    yield f"until {until:%Y-%m-%d %H:%M}, then as before"


def effect_table(effect: Mapping[str, Any]) -> list[str]:
    """Return the figures of the next day, without and with the steering.

    effect : `now` and `then`, both of `Course.figures`; or `reason`, why there are none
    """
    if "reason" in effect:
        return [f"no prediction: {effect['reason']}"]
    lines = [f"{'the next 24 h by the twin, room as now':<40s}{'as it is':>10s}{'then':>10s}"]
    for key, (label, unit) in _ROWS.items():
        lines.append(f"{label + ' [' + unit + ']':<40s}{effect['now'][key]:>10g}{effect['then'][key]:>10g}")
    return lines


def effect_lines(effect: Mapping[str, Any]) -> list[str]:
    """Return the same figures as sentences, for a display that has no columns."""
    if "reason" in effect:
        return effect_table(effect)
    now, then = effect["now"], effect["then"]
    return [
        "the next 24 h by the twin, room as now:",
        *(
            f"{label}: {now[key]:g} {unit} as it is, {then[key]:g} {unit} then"
            for key, (label, unit) in _ROWS.items()
        ),
    ]


def _clock(since_midnight_s: float) -> str:
    minutes = round(since_midnight_s / 60.0)
    return f"{minutes // 60:02d}:{minutes % 60:02d}"


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
    """A day, a row per step: air and reference at its end [°C], heater duty and fan in it; all [N].

    heater_w : at full duty
    """

    temps: Floats
    reference: Floats
    duty: Floats
    fan: Floats
    step_s: float
    heater_w: float

    def figures(self) -> dict[str, Any]:
        """JSON values, units in the keys."""
        errors = np.abs(self.temps - self.reference)
        return {
            "temp_air_low_c": round(float(self.temps.min()), 1),
            "temp_air_high_c": round(float(self.temps.max()), 1),
            "mean_error_k": round(float(errors.mean()), 2),
            "within_half_a_degree_pct": round(100.0 * float((errors < NEAR_K).mean())),
            "heat_wh": round(float(self.duty.sum()) * self.heater_w * self.step_s / 3600.0),
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
    heater_w = twin.geometry.heater_max_w
    return PredictedDay(temps, reference[:steps], chosen[:, 0], chosen[:, 1], twin.step_s, heater_w)


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


Json = dict[str, Any]


def predict_day(
    twin: BoxTwin | None, status: Mapping[str, Any], steering: Steering, settings: Settings
) -> Json:
    """Figures of the next day as it stands, `now`, and with the steering, `then`; else the `reason`."""
    if twin is None:
        return {"reason": "there is no twin in the active bundle"}
    tick, operation = status["tick"], status["operation"]
    temp, ambient = tick["estimate"]["temp_air_c"], tick["estimate"]["temp_ambient_c"]
    if temp is None or ambient is None or not math.isfinite(temp + ambient):
        return {"reason": "the air temperature is not known now"}
    midnight_s = seconds_of_day(tick["utc"], zone_of(settings.timezone))
    here = DayStart(temp, ambient, status["reference_time_s"], midnight_s)
    standing = operation["steering"] and steering_from_dict(operation["steering"])
    configured = in_force(operation["reference_c"], standing, _without_words(status, settings))
    before = _goal(configured, standing, operation["controller"], settings)
    after = _goal(reference_of(steering) or configured, steering, operation["controller"], settings)
    try:
        return {
            "now": coming_day(twin, here, before).figures(),
            "then": coming_day(twin, here, after).figures(),
        }
    except DataError as error:
        return {"reason": str(error)}


def _without_words(status: Mapping[str, Any], settings: Settings) -> Reference:
    """Return the reference where nobody has set one by hand or in words."""
    profile = profile_of(status["operation"])
    return profile.reference(status["reference_time_s"]) if profile else make_reference(settings.reference)


def _goal(
    reference: Reference, steering: Steering | None, controller: str, settings: Settings
) -> PlannerGoal:
    weight = settings.control.effort_weight(controller)
    heater = fan = None
    if steering is not None:
        heater, fan = steering.heater_penalty, steering.fan_penalty
    return PlannerGoal(
        reference,
        weight if heater is None else heater,
        weight if fan is None else fan,
        settings.safety.heater_max_duty,
        steering,
    )
