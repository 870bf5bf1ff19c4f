"""The predicted effect of a steering, from the control loop's own status."""

import math
from collections.abc import Mapping
from typing import Any

from edge.assistant.requests.effect import DayStart, PlannerGoal, coming_day
from edge.config.settings import Settings
from edge.core.errors import DataError
from edge.tick.reference import Reference, make_reference, seconds_of_day, zone_of
from edge.tick.steering import Steering
from edge.tick.steering import from_dict as steering_from_dict
from edge.tick.steering_at_work import in_force, reference_of
from edge.twin.model import BoxTwin

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
    here = DayStart(temp, ambient, status["since_start_s"], midnight_s)
    standing = operation["steering"] and steering_from_dict(operation["steering"])
    configured = in_force(operation["reference_c"], standing, make_reference(settings.reference))
    before = _goal(configured, standing, operation["controller"], settings)
    after = _goal(reference_of(steering) or configured, steering, operation["controller"], settings)
    try:
        return {
            "now": coming_day(twin, here, before).figures(),
            "then": coming_day(twin, here, after).figures(),
        }
    except DataError as error:
        return {"reason": str(error)}


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
