"""Standing orders as JSON values, for the state file and the status, and back."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from edge.messages import Command
from edge.names import ACTUATORS
from edge.operation import Before, FanMode, Mode, Operation
from edge.steering import steering as steerings
from edge.steering.steering import Steering


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
    return None if values is None else steerings.from_dict(values)


def _before(values: Mapping[str, Any] | None) -> Before | None:
    if values is None:
        return None
    reference = values["reference_c"]
    return Before(None if reference is None else float(reference), _steering(values["steering"]))


def from_dict(values: Mapping[str, Any]) -> Operation:
    """Inverse of `to_dict`. Errors: KeyError, ValueError, TypeError on values `to_dict` never wrote."""
    until = values["maintenance_until_utc"]
    reference = values["reference_c"]
    manual = Command(**values["manual"])
    for name, value in (("heater_duty", manual.heater_duty), ("led", manual.led)):
        if not ACTUATORS[name].low <= value <= ACTUATORS[name].high:
            raise ValueError(f"manual.{name}: {value!r}")
    return Operation(
        controller=str(values["controller"]),
        mode=Mode(values["mode"]),
        fan_mode=FanMode(values["fan_mode"]),
        reference_c=None if reference is None else float(reference),
        manual=manual,
        emergency_stop=bool(values["emergency_stop"]),
        maintenance_until_utc=None if until is None else float(until),
        steering=_steering(values.get("steering")),  # not in files of earlier software
        before=_before(values.get("before")),
    )
