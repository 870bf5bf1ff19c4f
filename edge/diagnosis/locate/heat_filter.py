"""A Kalman filter over many runs that follows heat which the twin does not know.

The state of each run is the twin's [n], then two heats into the air, constant over each step: one that
wanders from step to step (a random walk) and one that is new in each. A constant or slow missing effect is in
the first, so that it is not taken for a new error at every row (an augmented-state disturbance observer;
Maybeck 1979, Stochastic Models, ch. 6; likelihood by prediction errors, Kristensen et al. 2004).

Heats are shares of the heater's full power: a box of twice the power, loss and capacity is filtered alike.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.twin.filter import InnovationGain, predict, symmetric, update_many, weigh
from edge.twin.linearise import linearise
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import at_rest, hold, spread

Floats = NDArray[np.float64]
LOOSE = 17.0  # sd of a heat that may be any
START = 0.5  # sd of the unknown heat before the first row
WANDER = (0.0005, 0.0017, 0.005, 0.017, 0.05, 0.17, 0.5, 1.7)  # levels tried, from step to step
FRESH = (0.0, 0.017, 0.05, 0.17, 0.5)
NOISE_ROWS = 500  # of each run, that the levels are chosen on


class HeatNoise(NamedTuple):
    """Noise of the unknown heat, G levels of each, shares of the heater's power.

    wander : sd of its change from step to step; fresh : sd of what is new in each step and gone in the next
    """

    wander: Floats
    fresh: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """N steps of B runs as matrices of the widened state, m = n + 2.

    matrix : [N, B, m, m]; driven : [N, B, m], what the inputs add
    temp : [N, B], measured after each step, NaN where not [°C]
    start, start_sd : [B, m], [m], before the first step
    loose : [N, B], steps in which any heat may come, so that they say nothing of the usual one
    """

    matrix: Floats
    driven: Floats
    temp: Floats
    start: Floats
    start_sd: Floats
    loose: NDArray[np.bool_]


def steps_of(twin: BoxTwin, runs: RunBatch, sensor_k: float) -> Steps:
    """Return the runs' steps, bent heat by its tangent at the measured temperature.

    Errors : DataError for a room that is not known, or a column that the twin needs
    """
    if not runs.has_ambient:
        raise DataError("temp_ambient_c: not known, so no heat towards the room can be found")
    linear = linearise(twin, runs)
    rows, count, size = linear.driven.shape
    matrix = np.zeros((rows, count, size + 2, size + 2))
    matrix[..., :size, :size] = linear.table[linear.index]
    matrix[..., :size, size:] = twin.geometry.heater_max_w * linear.heat[..., None]
    matrix[..., size, size] = 1.0
    first = np.array([hold(temp)[0] for temp in runs.temp])
    return Steps(
        matrix,
        np.pad(linear.driven, ((0, 0), (0, 0), (0, 2))),
        runs.temp[:, 1:].T,
        np.pad(at_rest(twin, first, runs.ambient[:, 0]), ((0, 0), (0, 2))),
        np.concatenate([[sensor_k], spread(twin)[1:], [START, 0.0]]),
        np.zeros((rows, count), dtype=bool),
    )


def likeliest(steps: Steps, sensor_k: float, wander: Sequence[float] = WANDER) -> HeatNoise:
    """Return the noise levels, of those tried, at which all runs together are likeliest."""
    levels = HeatNoise(*(axis.ravel() for axis in np.meshgrid(wander, FRESH)))
    cost = np.zeros(len(levels.wander))
    for found in islice(_filter(steps, sensor_k, levels), NOISE_ROWS):
        own = np.log(found.variance) + found.innovation**2 / found.variance
        cost += np.where(np.isfinite(found.innovation), own, 0.0).sum(axis=-1)
    best = [int(cost.argmin())]
    return HeatNoise(levels.wander[best], levels.fresh[best])


def filter_heat(steps: Steps, sensor_k: float, noise: HeatNoise) -> InnovationGain:
    """Filter at one noise level: innovations and variances [N, B], gains [N, B, m].

    sensor_k : sd of a measured temperature, its step's error included
    """
    rows = list(_filter(steps, sensor_k, noise))
    return InnovationGain(*(np.stack(column)[:, 0] for column in zip(*rows, strict=True)))


def white(way: InnovationGain) -> Floats:
    """Innovations in standard deviations, [B, N]; NaN where nothing was measured."""
    return np.asarray(way.innovation / np.sqrt(way.variance)).T


def _filter(steps: Steps, sensor_k: float, noise: HeatNoise) -> Iterator[InnovationGain]:
    """Yield each row's reading against what the rows before it say, [G, B]."""
    levels, size = len(noise.wander), len(steps.start_sd)
    mean = np.repeat(steps.start[None], levels, axis=0)
    covariance = np.tile(np.diag(steps.start_sd**2), (levels, len(steps.start), 1, 1))
    unknown = np.zeros((levels, 1, size, size))
    unknown[:, 0, -2, -2], unknown[:, 0, -1, -1] = noise.wander**2, noise.fresh**2
    for matrix, driven, temp, loose in zip(steps.matrix, steps.driven, steps.temp, steps.loose, strict=True):
        covariance = covariance + unknown
        covariance[..., -1, -1] += LOOSE**2 * loose
        mean = (matrix @ mean[..., None])[..., 0] + driven
        covariance = predict(covariance, matrix, np.zeros(()))
        found = weigh(mean, covariance, temp, sensor_k**2)
        yield found
        mean, covariance = update_many(mean, covariance, found)
        covariance = symmetric(covariance)
