"""Each value that survives a restart as JSON values, and back; `edge/state/store.py` lists them.

A decoder raises an error for anything that its encoder does not write. Orders have their codec in
`edge/tick/orders_json.py`, because the status carries them in the same form.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.assistant.llm.budget import Spent
from edge.core.controller_names import CONTROLLERS
from edge.drift import noise, where
from edge.drift.evidence import Evidence
from edge.drift.memory import DriftMemory
from edge.forecasts.skill import ErrorPair, SkillState, Width
from edge.safety.memory import Dose, SafetyMemory
from edge.tick import orders_json
from edge.tick.orders import Operation

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StandingState:
    """Standing orders, and what safety has latched."""

    operation: Operation
    memory: SafetyMemory
    broken: str = ""  # why the state file could not be understood


def encode_standing(state: StandingState) -> dict[str, Any]:
    """Return orders under "operation", safety's memory under "safety"."""
    return {"operation": orders_json.to_dict(state.operation), "safety": encode_safety(state.memory)}


def decode_standing(values: Mapping[str, Any]) -> StandingState:
    """Invert `encode_standing`. Errors: KeyError, TypeError, ValueError"""
    operation = orders_json.from_dict(values["operation"])
    if operation.controller not in CONTROLLERS:
        raise ValueError(f"unknown controller {operation.controller!r}")
    return StandingState(operation, decode_safety(values["safety"]))


def encode_safety(memory: SafetyMemory) -> dict[str, Any]:
    """Return latched trips and the water of the last day; the rest of the memory may be lost."""
    return {"trips": list(memory.trips), "doses": [[dose.utc, dose.length_s] for dose in memory.doses]}


def decode_safety(values: Mapping[str, Any]) -> SafetyMemory:
    """Invert `encode_safety`. Errors: KeyError, TypeError, ValueError on what it never wrote."""
    trips = values["trips"]
    if not isinstance(trips, list) or not all(isinstance(trip, str) for trip in trips):
        raise ValueError(f"trips: {trips!r}")
    doses = tuple(Dose(None, float(utc), float(length_s)) for utc, length_s in values["doses"])
    if not all(math.isfinite(dose.utc) and 0.0 <= dose.length_s < math.inf for dose in doses):
        raise ValueError("doses: not times and lengths of 0 or more")
    return SafetyMemory(trips=tuple(trips), doses=doses)


def encode_skill(state: SkillState) -> dict[str, Any]:
    """Return a list of lists for each part, keys first."""
    return {
        "pairs": [
            [*key, *pair.versions, pair.scored, pair.mae_k, pair.reference_mae_k]
            for key, pair in state.pairs.items()
        ],
        "widths": [
            [*key, width.version, width.half_width_k, width.scored, width.covered]
            for key, width in state.widths.items()
        ],
    }


def decode_skill(values: Mapping[str, Any]) -> SkillState:
    """Invert `encode_skill`. Errors: ValueError for anything that it does not write."""
    try:
        pairs = {
            (str(name), int(horizon), str(reference)): ErrorPair(
                (str(version), str(other)), _count(scored), _size(mae_k), _size(reference_mae_k)
            )
            for name, horizon, reference, version, other, scored, mae_k, reference_mae_k in values["pairs"]
        }
        widths = {
            (str(name), int(horizon)): Width(str(version), _above_0(half), _count(scored), _size(covered))
            for name, horizon, version, half, scored, covered in values["widths"]
        }
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"no state of the forecasts' skill: {error!r}") from error
    return SkillState(pairs, widths)


def _count(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise ValueError(f"{value!r} is no count")
    return value


def _size(value: Any) -> float:
    if isinstance(value, bool) or not 0.0 <= value < math.inf:  # NaN fails too
        raise ValueError(f"{value!r} is no size")
    return float(value)


def _above_0(value: Any) -> float:
    if not _size(value) > 0.0:
        raise ValueError(f"{value!r} is not above 0")
    return float(value)


def encode_drift(memory: DriftMemory | None) -> dict[str, Any]:
    """Return JSON values; numbers that JSON has not become null."""
    assert memory is not None  # there is something to save
    values = asdict(memory)
    values["evidence"] = {
        item.name: _listed(getattr(memory.evidence, item.name)) for item in fields(Evidence)
    }
    values |= {name: _listed(getattr(memory, name)) for name in ("sums", "table")}
    return values | {"since_utc": memory.since_utc if memory.disagrees else None}


def decode_drift(values: Mapping[str, Any]) -> DriftMemory:
    """Invert `encode_drift`. Errors: ValueError for anything that it does not write."""
    try:
        since_utc, agreeing_s = values["since_utc"], float(values["agreeing_s"])
        given = values["evidence"]
        fresh = Evidence.none(0.0)
        return DriftMemory(
            str(values["twin_sha256"]),
            Evidence(
                _array(given["log_sum"], fresh.log_sum, -math.inf),
                _array(given["cusum"], fresh.cusum),
                _array(given["since_utc"], fresh.since_utc),
            ),
            _array(values["sums"], noise.nothing_learnt()),
            _array(values["table"], where.empty()),
            math.nan if since_utc is None else float(since_utc),
            agreeing_s if math.isfinite(agreeing_s) else 0.0,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"no state of a drift monitor: {error!r}") from error


def _listed(array: Floats) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in array.flat]


def _array(values: list[float | None], like: Floats, instead_of_null: float = math.nan) -> Floats:
    found = np.array([instead_of_null if value is None else value for value in values], dtype=np.float64)
    if found.size != like.size or not (np.isfinite(found) | (found == instead_of_null)).all():
        raise ValueError(f"{found.size} numbers, not {like.size}")
    return found.reshape(like.shape)


def encode_spent(spent: Spent) -> dict[str, Any]:
    """Return a key each."""
    return asdict(spent)


def decode_spent(values: Mapping[str, Any]) -> Spent:
    """Invert `encode_spent`. Errors: KeyError, TypeError, ValueError, OverflowError"""
    spent = Spent(str(values["day"]), int(values["tokens"]), float(values["cost"]), int(values["exchanges"]))
    if not (spent.tokens >= 0 and spent.exchanges >= 0 and 0.0 <= spent.cost < math.inf):
        raise ValueError(f"no costs of a day: {spent}")
    return spent
