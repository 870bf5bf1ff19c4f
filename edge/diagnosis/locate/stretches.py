"""When the twin disagrees: the stretches of runs that have far more of the squared error than of the rows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.residuals import Residuals

Floats = NDArray[np.float64]
ABOVE = 2.0  # times the mean squared error, that a stretch must be on average at either end
SMALLEST_SHARE = 0.05
FEWEST_ROWS = 5
MOST = 5


@dataclass(frozen=True, slots=True)
class Stretch:
    """Rows [from_row, to_row) of a run. share : of all runs' squared error; rmse_k : of the free run."""

    run: str
    from_row: int
    to_row: int
    from_s: float
    to_s: float
    share: float
    rmse_k: float


def stretches(runs: Sequence[Residuals]) -> list[Stretch]:
    """Return the stretches of time in which the squared error beyond `ABOVE`
    times the mean adds up to most, largest first.
    """
    squared = [np.nan_to_num(run.free_run_k) ** 2 for run in runs]
    total = float(sum(part.sum() for part in squared))
    count = sum(int(np.isfinite(run.free_run_k).sum()) for run in runs)
    if not total > 0.0:
        return []
    found = [
        _stretch(run, part, begin, end, total)
        for run, part in zip(runs, squared, strict=True)
        for begin, end in _richest(part - ABOVE * total / count)
    ]
    kept = [
        item for item in found if item.share >= SMALLEST_SHARE and item.to_row - item.from_row >= FEWEST_ROWS
    ]
    return sorted(kept, key=lambda item: -item.share)[:MOST]


def _stretch(run: Residuals, squared: Floats, begin: int, end: int, total: float) -> Stretch:
    known = np.isfinite(run.free_run_k[begin:end]).sum()
    part = float(squared[begin:end].sum())
    end_s = float(run.time_s[end - 1]) + run.step_s
    return Stretch(
        run.name, begin, end, float(run.time_s[begin]), end_s, part / total, float(np.sqrt(part / known))
    )


def _richest(values: Floats) -> list[tuple[int, int]]:
    """Disjoint ranges of the largest sums, the largest first (Kadane's scan, anew on either side of each)."""
    found, parts = [], [(0, len(values))]
    while parts:
        low, high = parts.pop()
        sums = np.concatenate([[0.0], np.cumsum(values[low:high])])
        gains = sums - np.minimum.accumulate(sums)
        end = int(gains.argmax())
        if not gains[end] > 0.0:
            continue
        begin = int(sums[: end + 1].argmin())
        found.append((low + begin, low + end))
        parts += [(low, low + begin), (low + end, high)]
    return found
