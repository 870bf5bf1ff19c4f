"""How far a free run of a twin is from recorded ones, at the hidden starts that suit each run best.

A free run is linear in its start, so the starts are found in closed form at any parameters (variable
projection; Golub & Pereyra 2003, Inverse Problems 19), held to a prior: rest, give or take `spread`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import at_rest, spread

Floats = NDArray[np.float64]


class FreeRun(NamedTuple):
    """Free runs of B runs from their best starts.

    residual : [B, N], measured minus predicted after each step; 0 where nothing was measured [K]
    measured : [B, N], whether it was
    start_pull : [B, n], how far each start is from its prior, in standard deviations
    """

    residual: Floats
    measured: NDArray[np.bool_]
    start_pull: Floats


def free_run(twin: BoxTwin, runs: RunBatch, ambient: Floats, noise_k: float) -> FreeRun:
    """Simulate the runs with the recorded inputs.

    ambient : [B, N] [°C]; noise_k : sd of what a free run misses, against which the prior is weighed [K]
    """
    count, size = len(runs.temp), len(twin.states)
    rest = np.stack(
        [at_rest(twin, temp, room) for temp, room in zip(runs.temp[:, 0], ambient[:, 0], strict=True)]
    )
    conditions = runs.conditions or None
    predicted = twin.rollout(rest, runs.duty, runs.fan, ambient, conditions=conditions)
    measured = runs.measured
    residual = np.where(measured, runs.temp[:, 1:] - predicted, 0.0)
    response = _responses(twin, runs, rest, ambient, predicted).reshape(count, size, -1)
    response = response * measured[:, None, :]
    response *= spread(twin)[:, None] / noise_k
    normal = response @ response.swapaxes(1, 2) + np.eye(size)
    pull = np.linalg.solve(normal, response @ (residual / noise_k)[:, :, None])[:, :, 0]
    explained = noise_k * np.einsum("bi,bik->bk", pull, response)
    return FreeRun(residual - explained, measured, np.asarray(pull, dtype=np.float64))


def _responses(twin: BoxTwin, runs: RunBatch, rest: Floats, ambient: Floats, predicted: Floats) -> Floats:
    """Return the sensor's response to a unit of each initial state, [B n, N]."""
    count, size = rest.shape
    unit = np.repeat(np.eye(size)[None], count, axis=0).reshape(-1, size)
    fans = np.repeat(runs.fan, size, axis=0)
    if twin.signals.plain:
        return twin.rollout(unit, np.zeros_like(fans), fans, 0.0)  # nothing but that state
    every = {name: np.repeat(column, size, axis=0) for name, column in runs.conditions.items()}
    duties, rooms = np.repeat(runs.duty, size, axis=0), np.repeat(ambient, size, axis=0)
    moved = twin.rollout(np.repeat(rest, size, axis=0) + unit, duties, fans, rooms, conditions=every)
    return moved - np.repeat(predicted, size, axis=0)


def rmse(run: FreeRun) -> float:
    """Root mean square of what was measured [K]."""
    return float(np.sqrt((run.residual**2).sum() / run.measured.sum()))
