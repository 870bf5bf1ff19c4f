"""Memory of a drift monitor, from tick to tick and from process to process."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.drift import noise, where
from edge.drift.evidence import Evidence

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DriftMemory:
    """About one twin.

    twin_sha256 : the twin's; what is known of one says nothing of another
    sums : what was learnt of its ordinary errors, see edge/drift/noise.py
    table : errors by regime, see edge/drift/where.py
    since_utc : since when it disagrees, NaN while it agrees
    agreeing_s : time without evidence, while it disagrees
    """

    twin_sha256: str
    evidence: Evidence
    sums: Floats = field(default_factory=noise.nothing_learnt)
    table: Floats = field(default_factory=where.empty)
    since_utc: float = math.nan
    agreeing_s: float = 0.0

    @property
    def disagrees(self) -> bool:
        """True while the alarm stands."""
        return math.isfinite(self.since_utc)


def to_dict(memory: DriftMemory) -> dict[str, Any]:
    """JSON values; numbers that JSON has not become null."""
    values = asdict(memory)
    values["evidence"] = {
        item.name: _listed(getattr(memory.evidence, item.name)) for item in fields(Evidence)
    }
    values |= {name: _listed(getattr(memory, name)) for name in ("sums", "table")}
    return values | {"since_utc": memory.since_utc if memory.disagrees else None}


def from_dict(values: Mapping[str, Any]) -> DriftMemory:
    """Errors: ValueError for anything that `to_dict` does not write."""
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
