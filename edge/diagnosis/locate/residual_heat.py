"""The residual as a heat flow: the heat that, added to the twin's air, explains what was measured.

The filter (`heat_filter`): the state of each run is the twin's [n], then two heats into the air [W],
constant over each step: one that wanders from step to step (a random walk) and one that is new in each. A
constant or slow missing effect is in the first, so that it is not taken for a new error at every row (an
augmented-state disturbance observer; Maybeck 1979, Stochastic Models, ch. 6; likelihood by prediction
errors, Kristensen et al. 2004).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.twin.filter import InnovationGain, predict, symmetric, update_many, weigh
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands, March
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import at_rest, spread

Floats = NDArray[np.float64]
LOOSE_W = 1000.0
START_SHARE = 0.5  # sd of the unknown heat before the first row, share of the heater's power


class HeatNoise(NamedTuple):
    """Noise of the unknown heat; G levels of each, or numbers.

    wander_w : sd of its change from step to step [W]
    fresh_w : sd of what is new in each step and gone in the next [W]
    """

    wander_w: Floats | float
    fresh_w: Floats | float


FOLLOWING = HeatNoise(10.0, 10.0)  # at which a filter believes its readings more than any twin


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """N steps of B runs as matrices of the widened state, m = n + 2.

    matrix : [N, B, m, m]; driven : [N, B, n], what the inputs add
    temp : [N, B], measured after each step, NaN where not [°C]
    start, start_sd : [B, m], [m], before the first step
    loose : [N + 1, B], steps in which any heat may come, so that they tell nothing of the usual one
    """

    matrix: Floats
    driven: Floats
    temp: Floats
    start: Floats
    start_sd: Floats
    loose: NDArray[np.bool_]

    def move(self, k: int, mean: Floats) -> Floats:
        """Return the mean after step k. mean : [..., B, m]"""
        after: Floats = (self.matrix[k] @ mean[..., None])[..., 0]
        after[..., :-2] += self.driven[k]
        return after


class HeatFilterResult(NamedTuple):
    """The filter's way over N steps of B runs, one noise level; index k belongs to the row after step k.

    innovation : [N, B], NaN where nothing was measured [K]; variance : [N, B], of it [K²]
    gain : [N, B, m], 0 where nothing was measured
    mean : [N + 1, B, m], covariance : [N + 1, B, m, m] of the row's state by the rows before it alone
    updated : [N + 1, B, m], by the row as well
    """

    innovation: Floats
    variance: Floats
    gain: Floats
    mean: Floats
    covariance: Floats
    updated: Floats


def steps_of(twin: BoxTwin, runs: RunBatch, sensor_k: float) -> Steps:
    """Return the runs' steps, with bent heat at the air temperature of a filter that follows the readings.

    Errors : DataError for a room that is not known, or a column that the twin needs
    """
    if not runs.has_ambient:
        raise DataError("temp_ambient_c: not known, so no heat towards the room can be told")
    commands = Commands(runs.duty, runs.fan)
    march = twin.march(commands, runs.ambient, conditions=runs.conditions or None)
    whole = reduce(lambda one, later: one.then(later), march.parts)
    rows, count, size = whole.driven.shape
    # Two states more: heat that stays through a run, and heat that wanders.
    matrix = np.zeros((rows, count, size + 2, size + 2))
    matrix[..., :size, :size] = whole.matrix
    matrix[..., :size, size:] = whole.gain[..., None] / twin.system.air_capacity_j_k
    matrix[..., size, size] = 1.0
    rest = [at_rest(twin, t, room) for t, room in zip(runs.temp[:, 0], runs.ambient[:, 0], strict=True)]
    heat_w = START_SHARE * twin.geometry.heater_max_w
    steps = Steps(
        matrix,
        whole.driven,
        runs.temp[:, 1:].T,
        np.pad(np.stack(rest), ((0, 0), (0, 2))),
        np.append(spread(twin), [heat_w, 0.0]),
        np.zeros((rows + 1, count), dtype=bool),
    )
    return _straighten(steps, march, sensor_k) if twin.signals.bends else steps


def _straighten(steps: Steps, march: March, sensor_k: float) -> Steps:
    """Bent heat as a part of what the inputs add."""
    seen = filter_heat(steps, sensor_k, FOLLOWING).updated[:-1, :, :-2]
    driven = np.stack([march.step(k, state) for k, state in enumerate(seen)])
    size = seen.shape[-1]
    straight = np.einsum("kbij,kbj->kbi", steps.matrix[:, :, :size, :size], seen)
    return replace(steps, driven=driven - straight)


def log_likelihoods(steps: Steps, sensor_k: float, noise: HeatNoise, rows: int) -> Floats:
    """Return the log likelihood of the first `rows` steps for each of the G noise levels, [G]."""
    wander, fresh = np.broadcast_arrays(np.asarray(noise.wander_w), np.asarray(noise.fresh_w))
    mean, covariance = _start(steps, sensor_k, fresh)
    total = np.zeros(len(wander))
    for k in range(min(rows, len(steps.temp))):
        mean, covariance = _predict(steps, k, mean, covariance, wander, fresh)
        found = weigh(mean, covariance, steps.temp[k], sensor_k**2)
        seen = np.isfinite(found.innovation)
        cost = np.log(found.variance) + np.nan_to_num(found.innovation) ** 2 / found.variance
        total -= 0.5 * np.where(seen, cost, 0.0).sum(axis=-1)
        mean, covariance = _update(mean, covariance, found)
    return total


def filter_heat(steps: Steps, sensor_k: float, noise: HeatNoise) -> HeatFilterResult:
    """Filter at one noise level. sensor_k : sd of a measured temperature, its step's error included"""
    wander, fresh = np.array([noise.wander_w]), np.array([noise.fresh_w])
    mean, covariance = _start(steps, sensor_k, fresh)
    means, covariances, updated, told = [mean[0]], [covariance[0]], [mean[0]], []
    for k in range(len(steps.temp)):
        mean, covariance = _predict(steps, k, mean, covariance, wander, fresh)
        means.append(mean[0])
        covariances.append(covariance[0])
        found = weigh(mean, covariance, steps.temp[k], sensor_k**2)
        told.append([column[0] for column in found])
        mean, covariance = _update(mean, covariance, found)
        updated.append(mean[0])
    innovations, variances, gains = (np.stack(column) for column in zip(*told, strict=True))
    return HeatFilterResult(
        innovations, variances, gains, np.stack(means), np.stack(covariances), np.stack(updated)
    )


def _start(steps: Steps, sensor_k: float, fresh: Floats) -> tuple[Floats, Floats]:
    count, size = steps.start.shape
    sd = np.broadcast_to(steps.start_sd, (len(fresh), size)).copy()
    sd[:, 0], sd[:, -1] = sensor_k, fresh
    covariance = np.zeros((len(fresh), count, size, size))
    covariance[...] = (sd**2)[:, None, :, None] * np.eye(size)
    covariance[..., -1, -1] += LOOSE_W**2 * steps.loose[0]
    return np.repeat(steps.start[None], len(fresh), axis=0), covariance


def _predict(
    steps: Steps, k: int, mean: Floats, covariance: Floats, wander: Floats, fresh: Floats
) -> tuple[Floats, Floats]:
    noise = np.zeros_like(covariance)
    noise[..., -2, -2] = wander[:, None] ** 2
    noise[..., -1, -1] = fresh[:, None] ** 2 + LOOSE_W**2 * steps.loose[k + 1]
    return steps.move(k, mean), predict(covariance, steps.matrix[k], noise)


def _update(mean: Floats, covariance: Floats, found: InnovationGain) -> tuple[Floats, Floats]:
    better, after = update_many(mean, covariance, found)
    return better, symmetric(after)


WANDER_W = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # levels tried, W from step to step
FRESH_W = (0.0, 1.0, 3.0, 10.0, 30.0)
NOISE_ROWS = 500  # of each run, that the levels are chosen on


@dataclass(frozen=True, slots=True, eq=False)
class ResidualHeat:
    """The unexplained heat of B runs, and the filter that found it.

    heat_w, sd_w : [B, N], by all rows of a run, and its sd; NaN after a run's last measurement [W]
    noise : the levels that suit the runs best
    """

    heat_w: Floats
    sd_w: Floats
    noise: HeatNoise
    steps: Steps
    way: HeatFilterResult


def residual_heat(
    twin: BoxTwin, runs: RunBatch, sensor_k: float | None = None, noise: HeatNoise | None = None
) -> ResidualHeat:
    """Unexplained heat by a fixed-interval smoother (de Jong 1989, JASA 84), all rows of a run used.

    sensor_k : sd of a measured temperature [K], the twin's own where None
    noise : how the heat varies; by maximum likelihood over all runs where None
    Errors : DataError for a room that is not known, or a column that the twin needs
    """
    sensor_k = twin.noise.sensor_k if sensor_k is None else sensor_k
    steps = steps_of(twin, runs, sensor_k)
    noise = noise or likeliest(steps, sensor_k)
    way = filter_heat(steps, sensor_k, noise)
    heat_w, variance = _smooth(steps, way)
    over = ~np.flip(np.logical_or.accumulate(np.flip(np.isfinite(steps.temp), 0), axis=0), 0)
    heat_w[over] = np.nan
    variance[over] = np.nan
    return ResidualHeat(heat_w.T, np.sqrt(np.maximum(variance, 0.0)).T, noise, steps, way)


def likeliest(steps: Steps, sensor_k: float, wander_w: Sequence[float] = WANDER_W) -> HeatNoise:
    """Return the noise levels, of those tried, at which all runs together are likeliest."""
    wander, fresh = (axis.ravel() for axis in np.meshgrid(wander_w, FRESH_W))
    best = int(log_likelihoods(steps, sensor_k, HeatNoise(wander, fresh), NOISE_ROWS).argmax())
    return HeatNoise(float(wander[best]), float(fresh[best]))


def _smooth(steps: Steps, way: HeatFilterResult) -> tuple[Floats, Floats]:
    """Both heats together, by all rows, [N, B], and their variance; an adjoint pass inverts nothing."""
    rows, count, size = way.gain.shape
    heat, variance = np.empty((rows, count)), np.empty((rows, count))
    score, information = np.zeros((count, size)), np.zeros((count, size, size))
    for k in range(rows - 1, -1, -1):
        score, information = _told_by_row(way, k, score, information)
        matrix = steps.matrix[k].swapaxes(-1, -2)
        score = (matrix @ score[..., None])[..., 0]
        information = matrix @ information @ steps.matrix[k]
        here_score, here_information = (
            _told_by_row(way, k - 1, score, information) if k else (score, information)
        )
        before = way.covariance[k]
        both = before[:, -2] + before[:, -1]  # how the sum of the two heats goes with each state
        heat[k] = way.mean[k][:, -2:].sum(axis=-1) + (both * here_score).sum(axis=-1)
        spread = before[:, -2:, -2:].sum(axis=(-1, -2))
        variance[k] = spread - np.einsum("bi,bij,bj->b", both, here_information, both)
    return heat, variance


def _told_by_row(way: HeatFilterResult, k: int, score: Floats, information: Floats) -> tuple[Floats, Floats]:
    """Return the information of the row after step k about the state before
    its update, added to that of later rows.
    """
    keeps = -way.gain[k][:, :, None] * np.eye(score.shape[-1])[0] + np.eye(score.shape[-1])
    weight = np.where(np.isfinite(way.innovation[k]), 1.0 / way.variance[k], 0.0)
    score = (keeps.swapaxes(-1, -2) @ score[..., None])[..., 0]
    information = keeps.swapaxes(-1, -2) @ information @ keeps
    score[:, 0] += weight * np.nan_to_num(way.innovation[k])
    information[:, 0, 0] += weight
    return score, information
