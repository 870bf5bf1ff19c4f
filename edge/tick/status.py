"""The loop's answer to "status": values in the control thread, JSON in the thread of the one who asked."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from edge.core.messages import Echo, TickRecord
from edge.core.names import SIGNALS
from edge.formats.tick_json import drift_json, echo_json, number, skill_json, tick_json
from edge.tick.calibration import CalibrationState, measurement
from edge.tick.faults import FAILURES
from edge.tick.orders import Operation
from edge.tick.orders_json import to_dict

STATUS = "status"  # the key of a reply whose value is a LoopStatus


@dataclass(frozen=True, slots=True)
class LoopStatus:
    """Standing orders, the last tick, the outputs that the board drives now, the line's counters."""

    operation: Operation
    since_start_s: float
    trips: tuple[str, ...]
    record: TickRecord | None  # of the last tick
    echo: Echo | None
    link_up: bool
    line: Mapping[str, int]
    conditions: tuple[str, ...] = ()  # rows of the failure table that hold
    calibration: tuple[CalibrationState, ...] = ()
    reference_time_s: float = 0.0  # on the axis of a configured reference that is not daily
    foreign_board: str = ""


def status_json(status: LoopStatus) -> dict[str, Any]:
    """Return JSON values; "tick" is null before the first tick. "plan" has heater duty and fan a step."""
    record = status.record
    return {
        "operation": to_dict(status.operation),
        "since_start_s": status.since_start_s,
        "reference_time_s": status.reference_time_s,
        "trips": list(status.trips),
        "tick": None if record is None else tick_json(record),
        "plan": [] if record is None else [list(map(number, step)) for step in record.decision.plan],
        "skill": {} if record is None else skill_json(record.skill),
        "drift": drift_json(record.drift if record else None),
        "echo": echo_json(status.echo),
        "link_up": int(status.link_up),
        "foreign_board": status.foreign_board,
        "line": dict(status.line),
        "conditions": {key: FAILURES[key].what for key in status.conditions},
        "calibration": {state.signal: calibration_json(state) for state in status.calibration},
    }


def calibration_json(state: CalibrationState) -> dict[str, Any]:
    """Return JSON values in the signal's unit; "reads" now, and "will_read" once its points are applied."""
    raw, after = state.raw, state.following
    return {
        "unit": SIGNALS[state.signal].unit,
        **asdict(state.present),
        "since_utc": state.utc,
        "reads": None if raw is None else measurement(state.present, raw),
        "following": None if after is None else asdict(after),
        "will_read": None if raw is None or after is None else measurement(after, raw),
        "points": [asdict(point) for point in state.points],
    }


def reply_json(reply: Mapping[str, Any]) -> dict[str, Any]:
    """Return a reply of the loop as JSON values, its status in place of the key STATUS."""
    encoded: dict[str, Any] = {}
    for key, value in reply.items():
        encoded |= status_json(value) if isinstance(value, LoopStatus) else {key: value}
    return encoded
