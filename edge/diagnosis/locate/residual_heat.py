"""The residual as a heat flow: the heat that, added to the twin's air, explains what was measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.heat_filter import (
    HeatFilterResult,
    HeatNoise,
    Steps,
    filter_heat,
    log_likelihoods,
    steps_of,
)
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch

Floats = NDArray[np.float64]
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
