"""Standing orders as JSON values, for the state file and the status, and back."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from edge.core.messages import Command
from edge.core.names import ACTUATORS
from edge.core.plain_text import shown
from edge.tick import steering as steerings
from edge.tick.orders import UTC_MAX, Before, FanMode, Mode, Operation
from edge.tick.steering import Steering

REFERENCE_C = (
    -20.0,
    80.0,
)  # sanity alone: the limits of today's settings are checked when an order is given [°C]


def to_dict(operation: Operation) -> dict[str, Any]:
    """JSON values, for the state file."""
    return {
        **asdict(operation),
        "mode": operation.mode.value,
        "fan_mode": operation.fan_mode.value,
        "manual": asdict(operation.manual),
        "steering": _steering_dict(operation.steering),
        "before": None if operation.before is None else _before_dict(operation.before),
    }


def _before_dict(before: Before) -> dict[str, Any]:
    return {"reference_c": before.reference_c, "steering": _steering_dict(before.steering)}


def _steering_dict(steering: Steering | None) -> dict[str, Any] | None:
    return None if steering is None else steerings.to_dict(steering)


def _steering(values: Mapping[str, Any] | None) -> Steering | None:
    """Errors: ValueError for what no operator could have confirmed at any time."""
    if values is None:
        return None
    steering = steerings.from_dict(values)
    just_before = _number("steering.until_utc", steering.until_utc, 0.0, UTC_MAX) - 1.0
    if wrong := steerings.problem(steering, just_before, -math.inf, math.inf):
        raise ValueError(f"steering: {wrong}")
    return steering


def _before(values: Mapping[str, Any] | None) -> Before | None:
    if values is None:
        return None
    return Before(_reference("before.reference_c", values["reference_c"]), _steering(values["steering"]))


def from_dict(values: Mapping[str, Any]) -> Operation:
    """Inverse of `to_dict`. Errors: KeyError, ValueError, TypeError on values `to_dict` never wrote."""
    until = values["maintenance_until_utc"]
    if not isinstance(values["emergency_stop"], bool):
        raise ValueError(f"emergency_stop: {shown(values['emergency_stop'])} is neither true nor false")
    return Operation(
        controller=str(values["controller"]),
        mode=Mode(values["mode"]),
        fan_mode=FanMode(values["fan_mode"]),
        reference_c=_reference("reference_c", values["reference_c"]),
        manual=_manual(Command(**values["manual"])),
        emergency_stop=values["emergency_stop"],
        maintenance_until_utc=None
        if until is None
        else _number("maintenance_until_utc", until, 0.0, UTC_MAX),
        steering=_steering(values.get("steering")),  # not in files of earlier software
        before=_before(values.get("before")),
    )


def _manual(command: Command) -> Command:
    for name in ("heater_duty", "led"):
        _number(f"manual.{name}", getattr(command, name), ACTUATORS[name].low, ACTUATORS[name].high)
    _number("manual.valve_pulse_s", command.valve_pulse_s, 0.0, 0.0)  # a standing order would flood
    if not isinstance(command.fan_on, bool):
        raise ValueError(f"manual.fan_on: {shown(command.fan_on)} is neither true nor false")
    return command


def _reference(place: str, value: Any) -> float | None:
    return None if value is None else _number(place, value, *REFERENCE_C)


def _number(place: str, value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f"{place}: {shown(value)} is not a number from {low:g} to {high:g}")
    return float(value)
