"""Means over seeds with 95 % confidence intervals; seeds are paired where two controllers are compared."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

SENSOR_K = 0.5  # the class of the air sensor: MAE that differ by less are not told apart (as in the paper)
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Mean:
    """Of n seeds, and half the width of its interval; infinite for one seed alone."""

    value: float
    half: float
    n: int

    @property
    def sure(self) -> bool:
        """Whether the interval leaves out 0."""
        return abs(self.value) > self.half


def mean_of(values: Sequence[float]) -> Mean:
    """Student's t over the seeds. Errors: ValueError without values"""
    if not values:
        raise ValueError("no values: a mean needs one")
    array = np.asarray(values, dtype=np.float64)
    n = len(array)
    if n == 1:
        return Mean(float(array[0]), float("inf"), 1)
    half = float(t.ppf(0.5 + CONFIDENCE / 2.0, n - 1) * array.std(ddof=1) / np.sqrt(n))
    return Mean(float(array.mean()), half, n)


def difference(one: Sequence[float], other: Sequence[float]) -> Mean:
    """One less the other, seed by seed."""
    return mean_of([a - b for a, b in zip(one, other, strict=True)])


def ratio(one: Sequence[float], other: Sequence[float]) -> Mean:
    """One by the other, seed by seed."""
    return mean_of([a / b for a, b in zip(one, other, strict=True)])


def told_apart(mae_difference: Mean) -> str:
    """ "better", "worse", or "undecided" inside the sensor's class or the seeds' spread."""
    if not abs(mae_difference.value) > SENSOR_K or not mae_difference.sure:
        return "undecided"
    return "better" if mae_difference.value < 0.0 else "worse"
