"""Blocks of time that a fit does not see, and is judged by."""

import numpy as np
from numpy.typing import NDArray

from edge.twin.run_batch import RunBatch

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
FOLDS = 5
BLOCKS = 20  # of all runs together
FIRST_ROWS = 10  # of a run, that are always seen: a forecast begins there


def folds(runs: RunBatch, count: int = FOLDS) -> list[Mask]:
    """Return the measured rows in `count` parts, [B, N] each. A part is
    contiguous in every run; the last part is the end.
    """
    numbers = parts(runs, count)
    return [numbers == i for i in range(count)]


def parts(runs: RunBatch, count: int) -> Indices:
    """Which part of its run each row is in, [B, N]; -1 where nothing was measured or the run begins."""
    known = np.isfinite(runs.temp[:, 1:])
    known[:, :FIRST_ROWS] = False
    place, rows = np.cumsum(known, axis=1) - 1, known.sum(axis=1, keepdims=True)
    return np.where(known, place * count // np.maximum(rows, 1), -1)


def halves(runs: RunBatch) -> Indices:
    """Which half of all that was measured each row is in, runs in the order given, [B, N]; -1 elsewhere."""
    known = np.isfinite(runs.temp[:, 1:])
    place = np.cumsum(known.ravel()).reshape(known.shape) - 1
    return np.where(known, place * 2 // max(int(known.sum()), 1), -1)


def block_sums(values: NDArray[np.float64], runs: RunBatch) -> NDArray[np.float64]:
    """Return sums over blocks of time. values : [B, N]; a value that is not finite counts as 0"""
    each = max(1, round(BLOCKS / len(runs.temp)))
    numbers = parts(runs, each) + each * np.arange(len(runs.temp))[:, None]
    chosen = parts(runs, 1) >= 0
    return np.asarray(
        np.bincount(numbers[chosen], np.nan_to_num(values[chosen]), minlength=each * len(runs.temp)),
        dtype=np.float64,
    )
