"""Innovations of many twins over the same runs: what each row tells beyond all rows before it.

A Kalman filter over each twin's states, a coloured heat into the air that the twin does not know (first
order, constant over a row) and one factor on the heater's power per run. Given linear steps and Gaussian
noise the sum of squared innovations is the likelihood, hidden starts and all (Jazwinski 1970, ch. 7;
Kristensen, Madsen & Jørgensen 2004, Automatica 40). It works on errors: a column is the measured minus a free
run, or the effect of something on a free run, and comes out whitened.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.twin.linear_steps import LinearSteps

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NoiseLevels:
    """What the twin can't know, standard deviations.

    sensor_k : of a reading, its rounding included; room_k : of the room's reading
    heat_w, heat_tau_s : unknown heat into the air, and how long it goes together
    power_share : of the heater's power from run to run
    """

    sensor_k: float
    room_k: float
    heat_w: float
    heat_tau_s: float
    power_share: float


class Filtered(NamedTuple):
    """A twin to be filtered: steps, noise, spread of its start [n], and the length of a row [s]."""

    steps: LinearSteps
    levels: NoiseLevels
    spread: Floats
    step_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """Of C filters over N rows of B runs, m states each, padded.

    closed : [N, C, B, m, m], what a row makes of the states, its reading taken in as 0
    shown : [N, C, B, m], what the reading is expected to be by the states before
    gain : [N, C, B, m], 0 where nothing was measured; sd : [N, C, B], of the innovation [K]
    """

    closed: Floats
    shown: Floats
    gain: Floats
    sd: Floats


def gains(twins: Sequence[Filtered], measured: NDArray[np.bool_]) -> Gains:
    """Run the covariances. measured : [B, N], after each row."""
    rows, runs = twins[0].steps.index.shape
    size = max(len(item.steps.states) for item in twins)
    count, m = len(twins), size + 2
    matrix, index, heat, duty, room = _stacked(twins, size)
    decay = np.array([np.exp(-item.step_s / item.levels.heat_tau_s) for item in twins])
    cov = np.zeros((count, runs, m, m))
    for i, (steps, levels, spread, _) in enumerate(twins):
        diagonal = np.zeros(m)
        diagonal[: len(steps.states)] = spread
        diagonal[size:] = levels.heat_w, levels.power_share
        cov[i] = np.diag(diagonal**2)
    sensor, fresh, dull = _variances(twins)
    fresh *= 1.0 - decay**2
    gain = np.zeros((rows, count, runs, m))
    sds = np.empty((rows, count, runs))
    step = np.zeros((rows, count, runs, m, m))
    step[..., :size, :size] = matrix[index]
    step[..., :size, size], step[..., :size, size + 1] = heat, duty
    step[..., size, size] = decay[:, None]
    step[..., size + 1, size + 1] = 1.0
    for k in range(rows):
        cov = step[k] @ cov @ step[k].swapaxes(-1, -2)
        cov[..., size, size] += fresh[:, None]
        moved = room[k] * dull[:, None, None]
        cov[..., :size, :size] += moved[..., :, None] * moved[..., None, :]
        variance = cov[..., 0, 0] + sensor[:, None]
        sds[k] = np.sqrt(variance)
        gain[k] = cov[..., 0] / variance[..., None] * measured[:, k, None]
        cov -= gain[k][..., :, None] * cov[..., 0, :][..., None, :]
    shown = step[..., 0, :].copy()
    step -= gain[..., :, None] * shown[..., None, :]
    return Gains(step, shown, gain, sds)


def _variances(twins: Sequence[Filtered]) -> tuple[Floats, Floats, Floats]:
    """Sensor [K²] and heat [W²], and the room's sd [K], [C] each."""
    levels = [item.levels for item in twins]
    return (
        np.array([item.sensor_k**2 for item in levels]),
        np.array([item.heat_w**2 for item in levels]),
        np.array([item.room_k for item in levels]),
    )


def _stacked(twins: Sequence[Filtered], size: int) -> tuple[Floats, NDArray[np.intp], Floats, Floats, Floats]:
    """All matrices behind each other [K, size, size], their index [N, C, B], and gains [N, C, B, size]."""
    rows, runs = twins[0].steps.index.shape
    tables, offset = [], 0
    index = np.empty((rows, len(twins), runs), dtype=np.intp)
    heat, duty, room = (np.zeros((rows, len(twins), runs, size)) for _ in range(3))
    for i, item in enumerate(twins):
        steps, own = item.steps, len(item.steps.states)
        tables.append(np.pad(steps.table, ((0, 0), (0, size - own), (0, size - own))))
        index[:, i] = steps.index + offset
        offset += len(steps.table)
        heat[:, i, :, :own], duty[:, i, :, :own], room[:, i, :, :own] = steps.heat, steps.duty, steps.room
    return np.concatenate(tables), index, heat, duty, room


def whitened(filters: Gains, owner: NDArray[np.intp], columns: Floats, everywhere: bool = False) -> Floats:
    """Columns in standard deviations of their innovation, 0 where nothing was measured.

    owner : [M], the filter of each column; columns : [M, B, N] [K], finite
    everywhere : also where nothing was measured, from what was before
    Returns : [M, B, N]
    """
    count, runs, rows = columns.shape
    state = np.zeros((count, runs, filters.gain.shape[-1]))
    found = np.empty((rows, count, runs))
    in_time = np.ascontiguousarray(columns.transpose(2, 0, 1))
    drive = filters.gain[:, owner] * in_time[..., None]
    for k in range(rows):
        found[k] = np.einsum("cbj,cbj->cb", filters.shown[k, owner], state)
        state = np.einsum("cbij,cbj->cbi", filters.closed[k, owner], state)
        state += drive[k]
    np.subtract(in_time, found, out=found)
    found /= filters.sd[:, owner]
    if everywhere:
        return found.transpose(1, 2, 0)
    seen = np.any(filters.gain[..., 0] != 0.0, axis=1)  # [N, B]
    return np.where(seen[:, None], found, 0.0).transpose(1, 2, 0)
