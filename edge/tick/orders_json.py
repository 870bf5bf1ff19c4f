"""Standing orders as JSON values, for the state file and the status, and back."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any

from edge.core.messages import Command
from edge.core.names import ACTUATORS, SIGNALS
from edge.formats.cross_check import CheckedDocument, Rule
from edge.formats.profile_file import REFERENCE_C
from edge.formats.reader import DocumentError, read, read_number
from edge.tick import steering as steerings
from edge.tick.calibration import POINTS_MAX, CalibrationPoint, StandingCalibration
from edge.tick.orders import UTC_MAX, Before, FanMode, Mode, Operation
from edge.tick.standing_profile import StandingProfile, Target
from edge.tick.steering import Steering


def to_dict(operation: Operation) -> dict[str, Any]:
    """JSON values, for the state file; newer keys only where needed: earlier software knows them not."""
    values = {
        **asdict(operation),
        "mode": operation.mode.value,
        "fan_mode": operation.fan_mode.value,
        # A person's fan is on or off, and earlier software does not support shares.
        "manual": {key: value for key, value in asdict(operation.manual).items() if key != "fan_share"},
    }
    profile, points, calibrations = (values.pop(key) for key in ("profile", "points", "calibrations"))
    del values["reference_start"]  # monotonic, see `edge.state.codecs.Limits`
    if profile is not None:
        keys = {item.name: item.metadata.get("key", item.name) for item in fields(StandingProfile)}
        values["profile"] = {keys[name]: value for name, value in profile.items()}
    return values | {
        key: list(items) for key, items in (("points", points), ("calibrations", calibrations)) if items
    }


@dataclass(frozen=True, slots=True)
class OperationDocument(CheckedDocument):
    """Orders as `to_dict` writes them; those with a default are not in files of earlier software."""

    controller: str
    mode: Mode
    fan_mode: FanMode
    reference_c: Target | None
    manual: Command
    emergency_stop: bool
    maintenance_until_utc: Annotated[float, Rule(low=0.0, high=UTC_MAX)] | None
    steering: Steering | None = None
    before: Before | None = None
    profile: StandingProfile | None = None
    points: Annotated[tuple[CalibrationPoint, ...], Rule(most=POINTS_MAX * len(SIGNALS))] = ()
    calibrations: Annotated[tuple[StandingCalibration, ...], Rule(most=len(SIGNALS))] = ()

    def cross_check(self) -> None:
        """Refuse orders that no operator could have given at any time."""
        for name in ("heater_duty", "led"):
            bounds = (ACTUATORS[name].low, ACTUATORS[name].high)
            read_number(getattr(self.manual, name), f"manual.{name}", *bounds)
        read_number(self.manual.valve_pulse_s, "manual.valve_pulse_s", 0.0, 0.0)  # would flood
        _check_steering(self.steering, "steering")
        if self.before is not None:
            _check_steering(self.before.steering, "before.steering")
            if self.before.reference_c is not None:
                read_number(self.before.reference_c, "before.reference_c", *REFERENCE_C)


def _check_steering(steering: Steering | None, key: str) -> None:
    """Errors: DataError for what no operator could have confirmed at any time"""
    if steering is None:
        return
    just_before = read_number(steering.until_utc, f"{key}.until_utc", 0.0, UTC_MAX) - 1.0
    if wrong := steerings.problem(steering, just_before, -math.inf, math.inf):
        raise DocumentError("", [(key, wrong)])


def from_dict(values: Mapping[str, Any]) -> Operation:
    """Invert `to_dict`. Errors: DataError on values that `to_dict` never wrote"""
    found = read(OperationDocument, values, key="operation")
    return Operation(**{item.name: getattr(found, item.name) for item in fields(OperationDocument)})
