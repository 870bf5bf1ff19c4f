"""Observation of a policy at a tick: the table that training and the rig share, computed in one place.

The hash of the table goes into a policy's file, and a policy made with another table is refused.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from edge.core.controller import Context
from edge.core.errors import DataError

Floats = NDArray[np.float64]

AIR_ROWS = 6  # temperatures that are looked at, the newest last
INPUT_ROWS = 30  # steps of heater and fan that are looked at, the newest last


@dataclass(frozen=True, slots=True)
class Feature:
    """One row of the table: what `of` gives over `steps`, divided by `scale`."""

    name: str
    unit: str
    scale: float  # of the order of its spread, in `unit`
    of: str  # a key of _RULES
    steps: int  # how far it looks back; 0: now
    meaning: str


FEATURES = (
    Feature("error", "K", 5.0, "error", 0, "reference minus air"),
    Feature("error_near", "K", 1.0, "error_near", 0, "the same, held within ±1 K: finer close by"),
    Feature("change_1", "K", 0.5, "change", 1, "air minus air a step ago"),
    Feature("change_2", "K", 1.0, "change", 2, "air minus air two steps ago"),
    Feature("change_5", "K", 2.0, "change", 5, "air minus air five steps ago"),
    Feature("above_room", "K", 10.0, "above_room", 0, "air minus the room's temperature"),
    Feature("duty_1", "1", 1.0, "duty", 1, "heater duty as driven in the last step"),
    Feature("duty_5", "1", 1.0, "duty", 5, "mean heater duty of the last five steps"),
    Feature("duty_10", "1", 1.0, "duty", 10, "mean of the last ten: the heater's element warms so slowly"),
    Feature("duty_30", "1", 1.0, "duty", 30, "mean of the last thirty: so do the walls"),
    Feature("fan_1", "1", 1.0, "fan", 1, "fan on in the last step"),
    Feature("fan_5", "1", 1.0, "fan", 5, "share of the last five steps with the fan on"),
    Feature("fan_10", "1", 1.0, "fan", 10, "share of the last ten"),
)
NAMES = tuple(feature.name for feature in FEATURES)


@dataclass(frozen=True, slots=True)
class Recent:
    """The last steps of B rigs, the newest last; what a rig has no memory of is as it was first, and off.

    air : [B, AIR_ROWS] [°C]; duty, fan : [B, INPUT_ROWS], as driven, 0..1
    ambient, reference : [B], now [°C]
    """

    air: Floats
    duty: Floats
    fan: Floats
    ambient: Floats
    reference: Floats


_RULES: dict[str, Callable[[Recent, int], Floats]] = {
    "error": lambda recent, steps: recent.reference - recent.air[:, -1],
    "error_near": lambda recent, steps: np.clip(recent.reference - recent.air[:, -1], -1.0, 1.0),
    "change": lambda recent, steps: recent.air[:, -1] - recent.air[:, -1 - steps],
    "above_room": lambda recent, steps: recent.air[:, -1] - recent.ambient,
    "duty": lambda recent, steps: recent.duty[:, -steps:].mean(axis=1),
    "fan": lambda recent, steps: recent.fan[:, -steps:].mean(axis=1),
}


def observe(recent: Recent) -> Floats:
    """Return the table of B rigs, [B, features], each in units of its
    scale; NaN where something is unknown.
    """
    table = np.empty((len(recent.air), len(FEATURES)))
    for column, feature in enumerate(FEATURES):
        table[:, column] = _RULES[feature.of](recent, feature.steps) / feature.scale
    return table


def observe_tick(context: Context) -> Floats:
    """Return the table at one tick of the daemon, [features]. Errors:
    DataError that names the unknown value
    """
    history = context.history
    if not len(history["temp_air"]):
        raise DataError("observation: no history")
    recent = Recent(
        air=_last(history["temp_air"], AIR_ROWS, before=float(history["temp_air"][0])),
        duty=_last(history["heater_duty"][:-1], INPUT_ROWS, before=0.0),
        fan=_last(history["fan_on"][:-1], INPUT_ROWS, before=0.0),
        ambient=np.array([context.estimate.temp_ambient]),
        reference=context.reference[:1],
    )
    observation: Floats = observe(recent)[0]
    unknown = [name for name, value in zip(NAMES, observation, strict=True) if not np.isfinite(value)]
    if unknown:
        raise DataError(f"observation: {', '.join(unknown)}: not a number")
    return observation


def by_name(observation: Floats) -> dict[str, float]:
    """Return the table in its units, for people and for JSON."""
    return {
        feature.name: round(float(value) * feature.scale, 6)
        for feature, value in zip(FEATURES, observation, strict=True)
    }


def table_sha256() -> str:
    """Return a hash of everything that makes an observation: order, rules, scales."""
    rows = [asdict(feature) for feature in FEATURES]
    text = json.dumps([AIR_ROWS, INPUT_ROWS, rows], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _last(column: Floats, rows: int, before: float) -> Floats:
    """Return the last rows, [1, rows]; `before` the first one."""
    tail = column[-rows:]
    return np.concatenate([np.full(rows - len(tail), before), tail])[None]
