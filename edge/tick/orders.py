"""What a person has asked of the rig: mode, controller, reference, manual command, stop, maintenance.

Command line, MQTT and, later, a language model end in the same `operate`. All of it survives a restart.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from enum import Enum
from typing import Any

from edge.core.errors import RequestError
from edge.core.hard_limits import MAINTENANCE_MAX_MIN
from edge.core.messages import Change, Command
from edge.core.names import HEATER_LEVELS
from edge.core.plain_text import plain, shown
from edge.tick.steering import Steering, problem
from edge.tick.steering import from_dict as steering_from_dict
from edge.tick.steering_at_work import steered

UTC_MAX = 1e11  # the year 5138; a calendar ends at 9999 [s since 1970]


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
class Before:
    """The orders that a confirmed steering took the place of."""

    reference_c: float | None = None
    steering: Steering | None = None


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
    steering: Steering | None = None  # what was asked for in words and confirmed
    before: Before | None = None  # what `undo` goes back to

    def steering_at(self, utc: float) -> Steering | None:
        """None once it has ended."""
        return self.steering if self.steering is not None and utc < self.steering.until_utc else None

    def in_maintenance(self, utc: float) -> bool:
        """Hands are in the box. A clock that lost the date prolongs it, until a person ends it."""
        return self.maintenance_until_utc is not None and utc < self.maintenance_until_utc


def acts_at_once(before: Operation, after: Operation) -> bool:
    """Whether new orders change what may be sent now; reference and controller wait for a decision."""
    waits = {name: getattr(before, name) for name in ("reference_c", "controller", "before")}
    return replace(after, **waits) != before


def has_lost_date(until_utc: float, utc: float) -> bool:
    """Whether no maintenance that ends at `until_utc` can have been ordered yet, by this clock."""
    return utc < until_utc - MAINTENANCE_MAX_MIN * 60


def is_released(before: Operation, after: Operation) -> bool:
    """Whether an order ended an emergency stop or a maintenance, over or not."""
    ended = before.maintenance_until_utc is not None and after.maintenance_until_utc is None
    return ended or (before.emergency_stop and not after.emergency_stop)


Request = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Desk:
    """What an order is checked against."""

    utc: float
    controllers: tuple[str, ...]
    reference_min_c: float
    reference_max_c: float
    configured_controller: str = ""
    unready: Callable[[str], str] = lambda name: ""  # why a controller cannot be chosen on this rig


def apply_orders(
    operation: Operation, command: Command, utc: float = 0.0, since_midnight_s: float = 0.0
) -> tuple[Command, tuple[Change, ...]]:
    """The controller's command after the standing orders, and what they changed.

    since_midnight_s : local time of day, for a rest of the fan
    """
    steering = operation.steering_at(utc)
    asked = command if steering is None else steered(command, steering, since_midnight_s)
    ordered = _ordered(operation, asked)
    reason = f"mode {operation.mode.value}, fan {operation.fan_mode.value}"
    if asked != command:
        reason += ", asked for in words"
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
        near = get_close_matches(plain(str(kind)), ORDERS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(ORDERS)}"
        raise RequestError(f"unknown request {shown(kind)}{hint}")
    refuse_unknown_keys(request, order.keys)
    return order.carry_out(operation, request, desk)


def refuse_unknown_keys(request: Request, known: tuple[str, ...]) -> None:
    """Errors: RequestError that names the first key that a request of this kind does not have."""
    for key in request:
        if key != "do" and key not in known:
            takes = f"known keys: {', '.join(known)}" if known else "it takes none"
            raise RequestError(f"{plain(str(request.get('do')), 40)}: unknown key {shown(key)}; {takes}")


@dataclass(frozen=True, slots=True)
class Order:
    """What a request does to the standing orders, and the keys that it may have."""

    carry_out: Callable[[Operation, Request, Desk], Operation]
    keys: tuple[str, ...] = ()


def _number(request: Request, key: str, low: float, high: float) -> float:
    value = request.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise RequestError(f"{key}: {shown(value)} is not a number from {low:g} to {high:g}")
    return float(value)


def _choice(request: Request, key: str, known: tuple[str, ...]) -> str:
    value = request.get(key)
    if value not in known:
        raise RequestError(f"{key}: {shown(value)} is not one of {', '.join(known)}")
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
    """A name of None asks for the configured controller."""
    named = {"name": desk.configured_controller} if request.get("name", "") is None else request
    if reason := desk.unready(str(named.get("name"))):
        raise RequestError(f"name: {reason}")
    return replace(operation, controller=_choice(named, "name", desk.controllers))


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


def _steer(operation: Operation, request: Request, desk: Desk) -> Operation:
    """A confirmed steering; a temperature that was set by hand before gives way to its reference."""
    try:
        steering = steering_from_dict(request["steering"])
    except (KeyError, TypeError, ValueError) as error:
        raise RequestError(f"steering: {plain(str(error))}") from None
    if wrong := problem(steering, desk.utc, desk.reference_min_c, desk.reference_max_c):
        raise RequestError(f"steering: {wrong}")
    before = Before(operation.reference_c, operation.steering_at(desk.utc))
    reference_c = None if steering.daily else operation.reference_c
    return replace(operation, reference_c=reference_c, steering=steering, before=before)


def _undo(operation: Operation, request: Request, desk: Desk) -> Operation:
    before = operation.before
    if before is None:
        raise RequestError("undo: nothing that was asked for in words is standing")
    return replace(operation, reference_c=before.reference_c, steering=before.steering, before=None)


ORDERS: dict[str, Order] = {
    "set_mode": Order(_set_mode, ("mode",)),
    "set_fan_mode": Order(_set_fan_mode, ("fan_mode",)),
    "set_reference": Order(_set_reference, ("reference_c",)),
    "set_controller": Order(_set_controller, ("name",)),
    "set_manual": Order(_set_manual, ("heater_duty", "fan_on", "led")),
    "emergency_stop": Order(_emergency_stop),
    "release_emergency_stop": Order(_release),
    "maintenance": Order(_maintenance, ("minutes",)),
    "steer": Order(_steer, ("steering",)),
    "undo": Order(_undo),
}
