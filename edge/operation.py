"""What a person has asked of the rig: mode, controller, reference, manual command, stop, maintenance.

Command line, MQTT and, later, a language model end in the same `operate`. All of it survives a restart.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from difflib import get_close_matches
from enum import Enum
from typing import Any

from edge.errors import RequestError
from edge.hard_limits import MAINTENANCE_MAX_MIN
from edge.messages import Change, Command
from edge.names import ACTUATORS, HEATER_LEVELS


class Mode(Enum):
    """Who decides. The names are those of a Home Assistant climate entity, and `manual`."""

    AUTO = "auto"  # the chosen controller
    HEAT = "heat"  # the chosen controller, the fan only for safety
    FAN_ONLY = "fan_only"  # the fan as the controller wants it, no heat
    OFF = "off"  # nothing
    MANUAL = "manual"  # the command a person gave


class FanMode(Enum):
    """A person's word on the fan, in every mode but manual and off."""

    AUTO = "auto"
    ON = "on"
    OFF = "off"


@dataclass(frozen=True, slots=True)
class Operation:
    """The standing orders."""

    controller: str
    mode: Mode = Mode.AUTO
    fan_mode: FanMode = FanMode.AUTO
    reference_c: float | None = None  # overrides the configured reference when set
    manual: Command = field(default_factory=Command)
    emergency_stop: bool = False
    maintenance_until_utc: float | None = None

    def in_maintenance(self, utc: float) -> bool:
        """Hands are in the box. A clock set back far does not prolong it beyond the longest allowed time."""
        until = self.maintenance_until_utc
        return until is not None and until - MAINTENANCE_MAX_MIN * 60 <= utc < until


def acts_at_once(before: Operation, after: Operation) -> bool:
    """Whether new orders change what may be sent now; reference and controller wait for a decision."""
    return replace(after, reference_c=before.reference_c, controller=before.controller) != before


Request = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Desk:
    """What an order is checked against."""

    utc: float
    controllers: tuple[str, ...]
    reference_min_c: float
    reference_max_c: float
    unready: Callable[[str], str] = lambda name: ""  # why a controller cannot be chosen on this rig


def apply_orders(operation: Operation, command: Command) -> tuple[Command, tuple[Change, ...]]:
    """The controller's command after the standing orders, and what they changed."""
    ordered = _ordered(operation, command)
    reason = f"mode {operation.mode.value}, fan {operation.fan_mode.value}"
    changes = tuple(
        Change("operator.orders", actuator, wanted, sent, reason)
        for actuator, wanted, sent in (
            ("heater_duty", command.heater_duty, ordered.heater_duty),
            ("fan_on", float(command.fan_on), float(ordered.fan_on)),
            ("led", command.led, ordered.led),
            ("valve_pulse", command.valve_pulse_s, ordered.valve_pulse_s),
        )
        if wanted != sent
    )
    return ordered, changes


def _ordered(operation: Operation, command: Command) -> Command:
    if operation.mode is Mode.OFF:
        return Command(led=command.led, valve_pulse_s=command.valve_pulse_s)
    if operation.mode is Mode.MANUAL:
        return operation.manual
    if operation.mode is Mode.FAN_ONLY:
        command = replace(command, heater_duty=0.0)
    if operation.mode is Mode.HEAT:
        command = replace(command, fan_on=False)
    if operation.fan_mode is not FanMode.AUTO:
        command = replace(command, fan_on=operation.fan_mode is FanMode.ON)
    return command


def operate(operation: Operation, request: Request, desk: Desk) -> Operation:
    """The standing orders after `request`. Errors: RequestError, and nothing has changed."""
    kind = request.get("do")
    order = ORDERS.get(kind) if isinstance(kind, str) else None
    if order is None:
        near = get_close_matches(str(kind), ORDERS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(ORDERS)}"
        raise RequestError(f"unknown request {kind!r}{hint}")
    return order(operation, request, desk)


Order = Callable[[Operation, Request, Desk], Operation]


def _number(request: Request, key: str, low: float, high: float) -> float:
    value = request.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise RequestError(f"{key}: {value!r} is not a number from {low:g} to {high:g}")
    return float(value)


def _choice(request: Request, key: str, known: tuple[str, ...]) -> str:
    value = request.get(key)
    if value not in known:
        raise RequestError(f"{key}: {value!r} is not one of {', '.join(known)}")
    return str(value)


def _set_mode(operation: Operation, request: Request, desk: Desk) -> Operation:
    return replace(operation, mode=Mode(_choice(request, "mode", tuple(mode.value for mode in Mode))))


def _set_fan_mode(operation: Operation, request: Request, desk: Desk) -> Operation:
    return replace(
        operation, fan_mode=FanMode(_choice(request, "fan_mode", tuple(mode.value for mode in FanMode)))
    )


def _set_reference(operation: Operation, request: Request, desk: Desk) -> Operation:
    if request.get("reference_c") is None:
        return replace(operation, reference_c=None)
    return replace(
        operation, reference_c=_number(request, "reference_c", desk.reference_min_c, desk.reference_max_c)
    )


def _set_controller(operation: Operation, request: Request, desk: Desk) -> Operation:
    if reason := desk.unready(str(request.get("name"))):
        raise RequestError(f"name: {reason}")
    return replace(operation, controller=_choice(request, "name", desk.controllers))


def _set_manual(operation: Operation, request: Request, desk: Desk) -> Operation:
    duty = _number({"heater_duty": operation.manual.heater_duty, **request}, "heater_duty", 0.0, 1.0)
    fan = _number({"fan_on": int(operation.manual.fan_on), **request}, "fan_on", 0, 1)
    led = _number({"led": operation.manual.led, **request}, "led", 0.0, 1.0)
    manual = Command(math.floor(duty * HEATER_LEVELS + 1e-9) / HEATER_LEVELS, fan >= 1, led)
    return replace(operation, mode=Mode.MANUAL, manual=manual)


def _emergency_stop(operation: Operation, request: Request, desk: Desk) -> Operation:
    return replace(operation, emergency_stop=True)


def _release(operation: Operation, request: Request, desk: Desk) -> Operation:
    return replace(operation, emergency_stop=False)


def _maintenance(operation: Operation, request: Request, desk: Desk) -> Operation:
    minutes = _number(request, "minutes", 0.0, MAINTENANCE_MAX_MIN)
    return replace(operation, maintenance_until_utc=desk.utc + minutes * 60 if minutes > 0 else None)


ORDERS: dict[str, Order] = {
    "set_mode": _set_mode,
    "set_fan_mode": _set_fan_mode,
    "set_reference": _set_reference,
    "set_controller": _set_controller,
    "set_manual": _set_manual,
    "emergency_stop": _emergency_stop,
    "release_emergency_stop": _release,
    "maintenance": _maintenance,
}


def to_dict(operation: Operation) -> dict[str, Any]:
    """JSON values, for the state file."""
    return {
        **asdict(operation),
        "mode": operation.mode.value,
        "fan_mode": operation.fan_mode.value,
        "manual": asdict(operation.manual),
    }


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
    )
