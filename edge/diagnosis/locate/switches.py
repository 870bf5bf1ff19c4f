"""Rows at which an input has just changed: what comes or goes then is more likely its own than a door's."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.twin.run_batch import RunBatch

Floats = NDArray[np.float64]
Kinds = NDArray[np.intp]
OFFSETS = (-1, 0, 1, 2)  # rows from a change to where what it does may seem to begin
FEWEST = 6  # changes of a kind, below which one cannot tell what is usual after them
FIRST_ROWS = 3  # of a run, in which a wrong start looks like an event
# Share of the rows by which the usual z² is told, and that of a normal variable. Events themselves may be in
# half of the rows; few are just at a change, but perhaps only some changes do something that is not known.
ANYWHERE, AT_CHANGE = (0.3, 0.1485), (0.8, 1.6424)


@dataclass(frozen=True, slots=True, eq=False)
class Switches:
    """kind : [B, N + 1], 0 where no input has just changed, else a number per input, direction and offset."""

    kind: Kinds

    @classmethod
    def of(cls, runs: RunBatch) -> "Switches":
        """Return the switches of heater, fan and light."""
        count, rows = runs.duty.shape
        kind = np.zeros((count, rows + 1), dtype=np.intp)
        light = [runs.conditions["light"]] if "light" in runs.conditions else []
        number = 1
        for values in (runs.duty, runs.fan, *light):
            change = np.diff(values, axis=1, prepend=values[:, :1])
            for changed in (change > 0.0, change < 0.0):
                for offset in OFFSETS:
                    places = np.argwhere(changed) + np.array([0, offset])
                    inside = (places[:, 1] >= 0) & (places[:, 1] <= rows)
                    kind[places[inside, 0], places[inside, 1]] = number
                    number += 1
        return cls(kind)

    def usual(self, z: Floats) -> Floats:
        """Usual size of z where a thing begins or ends like this, 1 at least; infinite where none can tell.

        z, returned : [B, N, L], by where an event begins and how long it is
        """
        rows, lengths = z.shape[1:]
        begins, by_end = _by_kind(self.kind[:, :-1], z), np.zeros((len(z), rows + 1, lengths))
        for length in range(1, min(lengths, rows) + 1):
            by_end[:, length:, length - 1] = z[:, : rows - length + 1, length - 1]
        ends = _by_kind(self.kind, by_end)
        for length in range(1, min(lengths, rows) + 1):
            here = begins[:, : rows - length + 1, length - 1]
            np.maximum(here, ends[:, length:, length - 1], out=here)
        begins[:, :FIRST_ROWS] = np.inf
        return begins


def _by_kind(kind: Kinds, z: Floats) -> Floats:
    """kind : [B, N]; z, returned : [B, N, L]."""
    found = np.ones_like(z)
    for number in np.unique(kind):
        here = kind == number
        share, normal = AT_CHANGE if number else ANYWHERE
        squares = np.sort(z[here] ** 2, axis=0)
        size = np.sqrt(squares[int(share * len(squares))] / normal)
        found[here] = np.maximum(size, 1.0) if number == 0 or here.sum() >= FEWEST else np.inf
    return found
