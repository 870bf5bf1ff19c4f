"""Ordinary errors of the twin, learnt in each cell, and innovations whitened by them.

In a cell (heater on or off, fan on or off) the innovations z, in units of the twin's own noise, are taken as
z = bias + phi z' + psi m' + scale e: z' the one before, m' the mean of the last half hour, so that e is near
to white with variance 1 whatever colour the heat noise has, minutes or hours (residual charts: Lu & Reynolds
1999, Journal of Quality Technology 31(3)). The four are learnt by least squares from the first ticks in the
cell and then kept, so that what comes later can't be learnt away. They are bounded: a twin that was wrong
from the first tick on is not taken for an honest one with more noise. Before a cell is learnt its scale lies
beyond the bound: gross disagreement is seen from the start.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.drift.regimes import CELLS

Floats = NDArray[np.float64]
SLOW_S = 1800.0  # of the running mean
BIAS_MAX = 0.5  # in units of the twin's own noise
GAIN_MIN, GAIN_MAX = -0.5, 0.97  # of phi + psi
SCALE_MIN, SCALE_MAX = 0.2, 3.0
CAUTIOUS_SCALE = 4.0  # noise as stated that keeps its sign for hours is no gross disagreement
WIDENED = 1.2  # of the learnt scale: it is an estimate, and its tails are not quite normal
_TERMS = 4  # 1, z', m', z
_RIDGE = 1e-6  # of regressors that never moved


class InnovationPast(NamedTuple):
    """The innovations before one, [*paths]."""

    last: Floats  # z'
    mean: Floats  # m'


def follow(past: InnovationPast, z: Floats, step_s: float) -> InnovationPast:
    """Return the past of the next innovation."""
    return InnovationPast(z, past.mean + min(1.0, step_s / SLOW_S) * (z - past.mean))


def nothing_learnt(paths: tuple[int, ...] = ()) -> Floats:
    """Return sums over no tick, [*paths, CELLS, 4, 4]: products of (1, z', m', z) with one another."""
    return np.zeros((*paths, CELLS, _TERMS, _TERMS))


def learnt(sums: Floats, cell: int, z: Floats, past: InnovationPast) -> Floats:
    """Return the sums with one more tick."""
    terms = _terms(z, past)
    more = sums.copy()
    more[..., cell, :, :] += terms[..., :, None] * terms[..., None, :]
    return more


def count(sums: Floats, cell: int) -> float:
    """Ticks that were learnt from in a cell; of the first path."""
    return float(sums[..., cell, 0, 0].flat[0])


def share_learnt(sums: Floats, ticks: int) -> float:
    """Return the share of ticks, in visited cells, that have been learnt, 0..1; of one path."""
    counts = np.minimum(sums[:, 0, 0], ticks)
    return float(counts.sum()) / (max(1, int(np.count_nonzero(counts))) * ticks)


def cautious(paths: tuple[int, ...] = ()) -> Floats:
    """Weights before anything is learnt."""
    return np.broadcast_to(np.array([0.0, 0.0, 0.0, 1.0]) / CAUTIOUS_SCALE, (*paths, _TERMS)).copy()


def weights(sums: Floats, cell: int) -> Floats:
    """Return the weights that whiten an innovation of the cell: e = weights . (1, z', m', z), [*paths, 4]."""
    products = sums[..., cell, :, :] / np.maximum(sums[..., cell, :1, :1], 1.0)
    left = products[..., :3, :3] + _RIDGE * np.eye(3)
    slopes = np.linalg.solve(left, products[..., :3, 3:])[..., 0]
    gain = slopes[..., 1] + slopes[..., 2]
    bounded = np.clip(gain, GAIN_MIN, GAIN_MAX)
    slopes[..., 1:] *= np.where(bounded == gain, 1.0, bounded / np.where(gain == 0.0, 1.0, gain))[..., None]
    # The bias that goes with the bounded slopes, then bounded itself: what is cut off stays in the residual.
    bias = products[..., 0, 3] - (slopes[..., 1:] * products[..., 0, 1:3]).sum(axis=-1)
    slopes[..., 0] = np.clip(bias, -BIAS_MAX, BIAS_MAX)
    found = np.concatenate([-slopes, np.ones_like(slopes[..., :1])], axis=-1)
    square = np.einsum("...i,...ij,...j->...", found, products, found)
    scale = np.clip(WIDENED * np.sqrt(np.maximum(square, 0.0)), SCALE_MIN, SCALE_MAX)
    whitening: Floats = found / scale[..., None]
    return whitening


def whiten(known: Floats, z: Floats, past: InnovationPast) -> Floats:
    """Return the innovation in units of the ordinary, [*paths]. known : as `weights` or `cautious`"""
    white: Floats = known[..., 0] + known[..., 1] * past.last + known[..., 2] * past.mean + known[..., 3] * z
    return white


def _terms(z: Floats, past: InnovationPast) -> Floats:
    return np.stack([np.ones_like(z), past.last, past.mean, z], axis=-1)
