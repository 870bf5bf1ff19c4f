"""Means over seeds with 95 % confidence intervals; seeds are paired where a ratio is formed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Mean:
    """Mean of n seeds, and half the width of its interval; infinite for one seed alone."""

    value: float
    half: float
    n: int


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


def ratio(one: Sequence[float], other: Sequence[float]) -> Mean:
    """One by the other, seed by seed."""
    return mean_of([a / b for a, b in zip(one, other, strict=True)])
