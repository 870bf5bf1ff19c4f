"""Standing orders of a person: mode, controller, reference, manual command, stop, maintenance.

Command line, MQTT and, later, a language model end in the same `operate`. All of it survives a restart.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from enum import Enum
from typing import Annotated, Any, TypeVar

from edge.core.errors import RequestError
from edge.core.hard_limits import MAINTENANCE_MAX_MIN
from edge.core.messages import Change, Command
from edge.core.plain_text import plain, quote
from edge.formats.cross_check import ABSENT, REQUIRED, Rule
from edge.formats.reader import DocumentError, read, read_number
from edge.tick.calibration import (
    CalibrationPoint,
    Named,
    SensorDesk,
    StandingCalibration,
    new_calibration,
    new_point,
)
from edge.tick.standing_profile import NAME_MAX, StandingProfile
from edge.tick.steering import Steering, level_below, problem, steer
from edge.tick.steering import from_dict as steering_from_dict

Request = Mapping[str, Any]

AUTHOR = "by"  # key of any request: who gave it
AUTHOR_MAX = 60  # characters
UTC_MAX = 1e11  # the year 5138; a calendar ends at 9999 [s since 1970]


def author_of(request: Request) -> dict[str, Any]:
    """Return the key AUTHOR of a request, for another one that carries it out; {} where it has none."""
    return {AUTHOR: request[AUTHOR]} if AUTHOR in request else {}


def with_author(text: str, request: Request) -> str:
    """Add who gave a request to what it did, where the request says it."""
    author = request.get(AUTHOR)
    if not isinstance(author, str) or not author:
        return text
    name = plain(author, AUTHOR_MAX)
    return f"{text} Ordered by {name}." if text.endswith(".") else f"{text}, by {name}"


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

    reference_c: float | None = field(default=None, metadata=REQUIRED)
    steering: Steering | None = field(default=None, metadata=REQUIRED)


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
    profile: StandingProfile | None = None  # stands in the place of the configured reference
    points: tuple[CalibrationPoint, ...] = ()  # taken and not yet applied
    calibrations: tuple[StandingCalibration, ...] = ()  # one a signal, in the place of the configured one
    reference_start: tuple[str, float] | None = (
        None  # of the configured reference: its sha256, since when [s]
    )

    def at(self, utc: float) -> "Operation":
        """Return the orders that hold at a time: every view shows these."""
        until = self.maintenance_until_utc if self.in_maintenance(utc) else None
        return replace(self, maintenance_until_utc=until, steering=self.steering_at(utc))

    def steering_at(self, utc: float) -> Steering | None:
        """None once it has ended."""
        return self.steering if self.steering is not None and utc < self.steering.until_utc else None

    def in_maintenance(self, utc: float) -> bool:
        """Hands are in the box. A clock that lost the date prolongs it, until a person ends it."""
        return self.maintenance_until_utc is not None and utc < self.maintenance_until_utc


def acts_at_once(before: Operation, after: Operation) -> bool:
    """Return whether new orders change what may be sent now. The others wait for the next decision."""
    names = ("reference_c", "controller", "before", "profile", "points", "calibrations")
    return replace(after, **{name: getattr(before, name) for name in names}) != before


def has_lost_date(until_utc: float, utc: float) -> bool:
    """Return whether, by this clock, a maintenance that ends at `until_utc` cannot have been ordered yet."""
    return utc < until_utc - MAINTENANCE_MAX_MIN * 60


def is_released(before: Operation, after: Operation) -> bool:
    """Return whether an order ended an emergency stop or a maintenance, over or not."""
    ended = before.maintenance_until_utc is not None and after.maintenance_until_utc is None
    return ended or (before.emergency_stop and not after.emergency_stop)


Keys = TypeVar("Keys")
Share = Annotated[float, Rule(low=0.0, high=1.0)]


@dataclass(frozen=True, slots=True)
class Desk:
    """The facts that an order is checked against."""

    utc: float
    controllers: tuple[str, ...]
    reference_min_c: float
    reference_max_c: float
    configured_controller: str = ""
    unready: Callable[[str], str] = lambda name: ""  # why a controller cannot be chosen on this rig
    sensors: SensorDesk | None = None


def apply_orders(
    operation: Operation, command: Command, utc: float = 0.0, since_midnight_s: float = 0.0
) -> tuple[Command, tuple[Change, ...]]:
    """Return the controller's command under the standing orders, and the changes they made.

    since_midnight_s : local time of day, for a rest of the fan
    """
    steering = operation.steering_at(utc)
    asked = command if steering is None else steer(command, steering, since_midnight_s)
    ordered = _command_of(operation, asked)
    reason = f"mode {operation.mode.value}, fan {operation.fan_mode.value}"
    if asked != command:
        reason += ", asked for in words"
    changes = tuple(
        Change("operator.orders", actuator, wanted, sent, reason)
        for actuator, wanted, sent in (
            ("heater_duty", command.heater_duty, ordered.heater_duty),
            ("fan_on", command.fan, ordered.fan),
            ("led", command.led, ordered.led),
            ("valve_pulse", command.valve_pulse_s, ordered.valve_pulse_s),
        )
        if wanted != sent
    )
    return ordered, changes


def _command_of(operation: Operation, command: Command) -> Command:
    if operation.mode is Mode.OFF:
        return Command(led=command.led, valve_pulse_s=command.valve_pulse_s)
    if operation.mode is Mode.MANUAL:
        return operation.manual
    if operation.mode is Mode.FAN_ONLY:
        command = replace(command, heater_duty=0.0)
    if operation.mode is Mode.HEAT:
        command = replace(command, fan_on=False)
    if operation.fan_mode is not FanMode.AUTO:
        command = replace(command, fan_on=operation.fan_mode is FanMode.ON, fan_share=1.0)
    return command


def operate(operation: Operation, request: Request, desk: Desk) -> Operation:
    """Return the standing orders after `request`. Errors: RequestError, and nothing has changed"""
    kind = request.get("do")
    order = ORDERS.get(kind) if isinstance(kind, str) else None
    if order is None:
        near = get_close_matches(plain(str(kind)), ORDERS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(ORDERS)}"
        raise RequestError(f"unknown request {quote(kind)}{hint}")
    try:
        return order.carry_out(operation, read_request(order.keys, request), desk)
    except DocumentError as error:
        raise RequestError(str(error)) from None


def read_request(kind: type[Keys], request: Request) -> Keys:
    """Read the keys of `request` but "do" and AUTHOR as an object of `kind`. Errors: RequestError"""
    try:
        given = {key: value for key, value in request.items() if key not in ("do", AUTHOR)}
        return read(kind, given, plain(str(request.get("do")), 40))
    except DocumentError as error:
        raise RequestError(str(error)) from None


@dataclass(frozen=True, slots=True)
class NoKeys:
    """A request that says all by its name."""


@dataclass(frozen=True, slots=True)
class SetMode:
    """Keys of the request."""

    mode: Mode


@dataclass(frozen=True, slots=True)
class SetFanMode:
    """Keys of the request."""

    fan_mode: FanMode


@dataclass(frozen=True, slots=True)
class SetReference:
    """Keys of the request; null is the configured reference."""

    reference_c: float | None = None


@dataclass(frozen=True, slots=True)
class SetController:
    """Keys of the request; null is the configured controller."""

    name: str | None


@dataclass(frozen=True, slots=True)
class SetManual:
    """Keys of the request; what is absent stays."""

    heater_duty: Share = ABSENT
    fan_on: Share = ABSENT
    led: Share = ABSENT


@dataclass(frozen=True, slots=True)
class StartMaintenance:
    """Keys of the request; 0 ends it."""

    minutes: Annotated[float, Rule(low=0.0, high=MAINTENANCE_MAX_MIN)]


@dataclass(frozen=True, slots=True)
class Steer:
    """Keys of the request."""

    steering: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class StartProfile:
    """Keys of the request."""

    profile: StandingProfile


@dataclass(frozen=True, slots=True)
class CalibratePoint:
    """Keys of the request; the true value is in the signal's unit."""

    signal: Named
    true_value: float


@dataclass(frozen=True, slots=True)
class OneSignal:
    """Keys of a request about one signal."""

    signal: Named


@dataclass(frozen=True, slots=True)
class Order:
    """A request's change of the standing orders, and its permitted keys."""

    carry_out: Callable[[Operation, Any, Desk], Operation]
    keys: type = NoKeys


def _set_reference(operation: Operation, asked: SetReference, desk: Desk) -> Operation:
    if asked.reference_c is None:
        return replace(operation, reference_c=None)
    low, high = desk.reference_min_c, desk.reference_max_c
    return replace(operation, reference_c=read_number(asked.reference_c, "reference_c", low, high))


def _set_controller(operation: Operation, asked: SetController, desk: Desk) -> Operation:
    name = desk.configured_controller if asked.name is None else asked.name
    if reason := desk.unready(name):
        raise RequestError(f"name: {reason}")
    if name not in desk.controllers:
        raise RequestError(f"name: {quote(name)} is not one of {', '.join(desk.controllers)}")
    return replace(operation, controller=name)


def _set_manual(operation: Operation, asked: SetManual, desk: Desk) -> Operation:
    stands = operation.manual
    duty = stands.heater_duty if asked.heater_duty is None else asked.heater_duty
    fan_on = stands.fan_on if asked.fan_on is None else asked.fan_on >= 1.0
    led = stands.led if asked.led is None else asked.led
    manual = Command(level_below(duty), fan_on, led)
    return replace(operation, mode=Mode.MANUAL, manual=manual)


def _maintenance(operation: Operation, asked: StartMaintenance, desk: Desk) -> Operation:
    until_utc = desk.utc + asked.minutes * 60 if asked.minutes > 0 else None
    return replace(operation, maintenance_until_utc=until_utc)


def _steer(operation: Operation, asked: Steer, desk: Desk) -> Operation:
    """Apply a confirmed steering; its reference replaces a temperature that was set by hand before."""
    steering = steering_from_dict(asked.steering)
    if wrong := problem(steering, desk.utc, desk.reference_min_c, desk.reference_max_c):
        raise RequestError(f"steering: {wrong}")
    before = Before(operation.reference_c, operation.steering_at(desk.utc))
    reference_c = None if steering.daily else operation.reference_c
    return replace(operation, reference_c=reference_c, steering=steering, before=before)


def _undo(operation: Operation, asked: NoKeys, desk: Desk) -> Operation:
    before = operation.before
    if before is None:
        raise RequestError("undo: nothing that was asked for in words is standing")
    return replace(operation, reference_c=before.reference_c, steering=before.steering, before=None)


def _start_profile(operation: Operation, asked: StartProfile, desk: Desk) -> Operation:
    """Begin a profile; a temperature by hand or in words would hide it, so they end."""
    low, high = desk.reference_min_c, desk.reference_max_c
    for number, target in enumerate(asked.profile.targets_c):
        read_number(target, f"profile.targets_c[{number}]", low, high)
    steering = operation.steering
    if steering is not None:
        steering = replace(steering, daily=())
    profile = replace(asked.profile, name=plain(asked.profile.name, NAME_MAX))
    return replace(operation, reference_c=None, steering=steering, before=None, profile=profile)


def _in_profile(**changes: Any) -> Callable[[Operation, NoKeys, Desk], Operation]:
    """Return an order that changes the profile that is followed, if any."""
    return lambda operation, asked, desk: replace(
        operation, profile=operation.profile and replace(operation.profile, **changes)
    )


def _skip_profile(operation: Operation, asked: NoKeys, desk: Desk) -> Operation:
    profile = operation.profile
    if profile is None:
        return operation
    if profile.next_s is None:
        raise RequestError("the profile is over: there is no point to move to")
    return replace(operation, profile=replace(profile, position_s=profile.next_s))


def _sensors_of(desk: Desk) -> SensorDesk:
    if desk.sensors is None:
        raise RequestError("there are no sensors to calibrate")
    return desk.sensors


def _points_of(operation: Operation, signal: str) -> tuple[CalibrationPoint, ...]:
    return tuple(point for point in operation.points if point.signal == signal)


def _without(operation: Operation, signal: str) -> Operation:
    """Return the orders without the signal's points. Errors: RequestError where it has none"""
    if not _points_of(operation, signal):
        raise RequestError(f"{signal}: there is no calibration point")
    return replace(operation, points=tuple(each for each in operation.points if each.signal != signal))


def _without_calibration(operation: Operation, signal: str) -> tuple[StandingCalibration, ...]:
    return tuple(each for each in operation.calibrations if each.signal != signal)


def _calibrate_point(operation: Operation, asked: CalibratePoint, desk: Desk) -> Operation:
    before = _points_of(operation, asked.signal)
    point = new_point(asked.signal, asked.true_value, before, _sensors_of(desk), desk.utc)
    return replace(operation, points=(*operation.points, point))


def _apply_calibration(operation: Operation, asked: OneSignal, desk: Desk) -> Operation:
    after = _without(operation, asked.signal)
    found = new_calibration(_points_of(operation, asked.signal), _sensors_of(desk), desk.utc)
    return replace(after, calibrations=(*_without_calibration(operation, asked.signal), found))


def _reset_calibration(operation: Operation, asked: OneSignal, desk: Desk) -> Operation:
    left = _without_calibration(operation, asked.signal)
    if left == operation.calibrations:
        raise RequestError(f"{asked.signal}: it follows the configuration already")
    return replace(operation, calibrations=left)


ORDERS: dict[str, Order] = {
    "set_mode": Order(lambda operation, asked, desk: replace(operation, mode=asked.mode), SetMode),
    "set_fan_mode": Order(
        lambda operation, asked, desk: replace(operation, fan_mode=asked.fan_mode), SetFanMode
    ),
    "set_reference": Order(_set_reference, SetReference),
    "set_controller": Order(_set_controller, SetController),
    "set_manual": Order(_set_manual, SetManual),
    "emergency_stop": Order(lambda operation, asked, desk: replace(operation, emergency_stop=True)),
    "release_emergency_stop": Order(lambda operation, asked, desk: replace(operation, emergency_stop=False)),
    "maintenance": Order(_maintenance, StartMaintenance),
    "steer": Order(_steer, Steer),
    "undo": Order(_undo),
    "start_profile": Order(_start_profile, StartProfile),
    "pause_profile": Order(_in_profile(is_paused=True)),
    "resume_profile": Order(_in_profile(is_paused=False)),
    "skip_profile": Order(_skip_profile),
    "end_profile": Order(lambda operation, asked, desk: replace(operation, profile=None)),
    "calibrate_point": Order(_calibrate_point, CalibratePoint),
    "discard_points": Order(lambda operation, asked, desk: _without(operation, asked.signal), OneSignal),
    "apply_calibration": Order(_apply_calibration, OneSignal),
    "reset_calibration": Order(_reset_calibration, OneSignal),
}
