"""The room's temperature over each row, from readings at its ends that are noisy and rounded."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
RATIOS = np.logspace(-3.0, 2.0, 16)  # wander between two rows over the noise of a reading, variances
LEAST_ROWS = 10


def smooth(ambient: Floats) -> Floats:
    """Return the ambient without the noise of its readings. ambient : [B, N], without holes

    A random walk seen through white noise (local level model; Harvey 1989, Forecasting, ch. 2), the ratio of
    the two by maximum likelihood over all runs.
    """
    from scipy.linalg import solveh_banded

    rows = ambient.shape[1]
    if rows < LEAST_ROWS or not np.ptp(ambient, axis=1).any():
        return ambient
    ratio = RATIOS[int(np.argmax(_log_likelihoods(ambient, RATIOS)))]
    bands = np.zeros((2, rows))
    bands[1] = 1.0 + 2.0 / ratio
    bands[1, [0, -1]] = 1.0 + 1.0 / ratio
    bands[0, 1:] = -1.0 / ratio
    return np.asarray(solveh_banded(bands, ambient.T).T)


def _log_likelihoods(values: Floats, ratios: Floats) -> Floats:
    """Return the log likelihood of each ratio, up to a constant, at the best noise size."""
    level = np.repeat(values[:, 0][None], len(ratios), axis=0)
    variance, square, spread = np.ones(len(ratios)), np.zeros(len(ratios)), np.zeros(len(ratios))
    for reading in values.T[1:]:
        variance = variance + ratios
        total = variance + 1.0
        error = reading - level
        level += (variance / total)[:, None] * error
        variance /= total
        square += (error**2).sum(axis=1) / total
        spread += np.log(total)
    count = values.size - len(values)
    return -0.5 * (count * np.log(np.maximum(square, 1e-12) / count) + len(values) * spread)


def between(ambient: Floats) -> Floats:
    """In the middle of each row: half way to the next reading; ambient : [B, N]."""
    return np.concatenate([0.5 * (ambient[:, 1:] + ambient[:, :-1]), ambient[:, -1:]], axis=1)


WAYS = {"held": lambda ambient: ambient, "between": between}  # how the room goes from reading to reading


def over_rows(ambient: Floats, way: str) -> Floats:
    """Return the ambient over each row, [B, N]."""
    return np.asarray(WAYS[way](smooth(ambient)))
