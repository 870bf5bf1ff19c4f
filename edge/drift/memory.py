"""Memory of a drift monitor, from tick to tick and from process to process."""

import math
from dataclasses import dataclass, field

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
