"""Many twins over the same recorded runs in one pass: a loop over the rows, arrays over all else."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.twin.linear_steps import LinearSteps

Floats = NDArray[np.float64]


class EnsembleRun(NamedTuple):
    """What is to be run: steps, from a start [B, n] (None: 0), driven [N, B, n] (None: by nothing)."""

    steps: LinearSteps
    start: Floats | None
    driven: Floats | None


def responses(wanted: Sequence[EnsembleRun]) -> Floats:
    """What the sensor shows after each row, [len(wanted), B, N]."""
    rows, runs = wanted[0].steps.index.shape
    size = max(len(item.steps.states) for item in wanted)
    tables, index, offset = [], np.empty((rows, len(wanted), runs), dtype=np.intp), 0
    state = np.zeros((len(wanted), runs, size))
    driven = np.zeros((rows, len(wanted), runs, size))
    known: dict[int, int] = {}  # several responses of the same steps share a table
    for i, (steps, start, drive) in enumerate(wanted):
        own = len(steps.states)
        if id(steps) not in known:
            known[id(steps)] = offset
            table = np.zeros((len(steps.table), size, size))
            table[:, :own, :own] = steps.table
            tables.append(table)
            offset += len(steps.table)
        index[:, i] = steps.index + known[id(steps)]
        if start is not None:
            state[i, :, :own] = start
        if drive is not None:
            driven[:, i, :, :own] = drive
    flat = index.reshape(rows, -1)
    shown = _march(np.concatenate(tables), flat, state.reshape(-1, size), driven.reshape(rows, -1, size))
    return shown.reshape(rows, len(wanted), runs).transpose(1, 2, 0)


def _march(table: Floats, index: NDArray[np.intp], state: Floats, driven: Floats) -> Floats:
    shown = np.empty(index.shape)
    for k in range(len(index)):
        state = np.einsum("bij,bj->bi", table[index[k]], state)
        state += driven[k]
        shown[k] = state[:, 0]
    return shown
