"""Rows at which an input has just changed: heat that comes then is more likely the input's than a door's."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.twin.recorded import Recorded

Floats = NDArray[np.float64]
OFFSETS = (-1, 0, 1, 2)  # rows from a change to where what it does may seem to begin
FEWEST = 6  # changes of a kind, below which one cannot tell what is usual after them
QUANTILE = 0.3  # by which the usual size is told: events themselves may be in half of the rows
NORMAL_QUANTILE = 0.1485  # of the square of a standard normal variable, the same


@dataclass(frozen=True, slots=True, eq=False)
class Switches:
    """kind : [B, N], 0 where no input has just changed, else a number per input, direction and offset."""

    kind: NDArray[np.intp]

    @classmethod
    def of(cls, runs: Recorded) -> "Switches":
        """Of heater, fan and light."""
        kind = np.zeros(runs.duty.shape, dtype=np.intp)
        light = [runs.conditions["light"]] if "light" in runs.conditions else []
        number = 1
        for values in (runs.duty, runs.fan, *light):
            change = np.diff(values, axis=1, prepend=values[:, :1])
            for changed in (change > 0.0, change < 0.0):
                for offset in OFFSETS:
                    run, row = np.argwhere(changed).T
                    inside = (row + offset >= 0) & (row + offset < kind.shape[1])
                    kind[run[inside], row[inside] + offset] = number
                    number += 1
        return cls(kind)

    def usual(self, z: Floats) -> Floats:
        """Usual size of z at rows of the same kind, 1 at least; infinite where there are too few to tell.

        z, returned : [B, N, L], by where an event begins and how long it is
        """
        found = np.ones_like(z)
        for kind in np.unique(self.kind):
            here = self.kind == kind
            size = np.sqrt(np.quantile(z[here] ** 2, QUANTILE, axis=0) / NORMAL_QUANTILE)
            found[here] = np.maximum(size, 1.0) if kind == 0 or here.sum() >= FEWEST else np.inf
        return found
