"""Prediction intervals from the errors of calibration runs (split conformal prediction).

Errors within a run hang together, runs do not: the unit that is exchangeable is the run. So each run weighs
the same whatever its length, and the one still to come gets its share at infinity: the half width is the
quantile of the mixture sum_k 1/((K+1) n_k) sum_i |e_ki| + 1/(K+1) at infinity. A forecast from a new run is
then inside with at least the claimed probability, whatever the model and the distribution of its errors.
All forecasts of a run count, not one drawn from it: the guarantee is the same and the width scatters less.
Source: Lee, Barber and Willett, Distribution-free inference with hierarchical data, arXiv:2306.06342, sec. 3;
for single errors it is the usual ceil((n + 1)(1 - a)) / n (Vovk et al., Algorithmic Learning, 2005).
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.formats.atomic_file import write_atomically
from edge.formats.cross_check import Rule
from edge.formats.input_file import Source
from edge.formats.reader import read_json

Floats = NDArray[np.float64]
CLAIMED = 0.9  # share of the measurements that an interval shall hold
_FORMAT = 1
_ROUNDING = 1e-9  # of sums of weights


@dataclass(frozen=True, slots=True)
class Interval:
    """How far the air may be from one predictor's forecast at one horizon."""

    predictor: str
    version: str  # of the predictor that made the errors; for another one they say nothing
    horizon_min: int
    half_width_k: Annotated[float, Rule(above=0.0)]
    runs: int  # calibrated on so many
    regime: str  # what they were: "interpolation"


@dataclass(frozen=True, slots=True)
class Intervals:
    """A calibration; empty for predictors that have none."""

    rows: tuple[Interval, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def half_width(self, predictor: str, version: str, horizon_min: int) -> float | None:
        """Half width of the interval that claims CLAIMED [K]; None where there is no calibration."""
        key = (predictor, version, horizon_min)
        rows = (row for row in self.rows if (row.predictor, row.version, row.horizon_min) == key)
        return next((row.half_width_k for row in rows), None)


@dataclass(frozen=True, slots=True)
class IntervalsDocument:
    """The file, key by key."""

    format: Literal[1]
    claimed: Annotated[float, Rule(choices=(CLAIMED,))]
    intervals: tuple[Interval, ...]
    units: Mapping[str, str] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)


def half_width(errors: Sequence[Floats], claimed: float = CLAIMED) -> float:
    """Return the interval's half width from the errors of each run, shape
    [n_k] each; empty runs do not count.

    Returns : [K]; infinity where there are too few runs for the claim (fewer than 9 for 90 %)
    Raises : DataError for an error that is no number
    """
    runs = [np.abs(run) for run in errors if len(run)]
    if not runs:
        return math.inf
    sizes = np.concatenate(runs)
    if not np.isfinite(sizes).all():
        raise DataError("calibration: an error is not a number")
    weights = np.concatenate([np.full(len(run), 1.0 / ((len(runs) + 1) * len(run))) for run in runs])
    order = np.argsort(sizes, kind="stable")
    reached = np.cumsum(weights[order]) >= claimed - _ROUNDING
    return float(sizes[order][reached.argmax()]) if reached.any() else math.inf


def write_intervals(intervals: Intervals, path: Path) -> None:
    """Write the table that `read_intervals` reads. Errors: OSError."""
    document = {
        "format": _FORMAT,
        "claimed": CLAIMED,
        "units": {"half_width_k": "K", "horizon_min": "min"},
        "intervals": [
            {key: getattr(row, key) for key in Interval.__dataclass_fields__} for row in intervals.rows
        ],
        "provenance": dict(intervals.provenance),
    }
    write_atomically(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def read_intervals(path: Source) -> Intervals:
    """Read the calibration in `path`. Errors: DataError, naming the file and the row"""
    document = read_json(IntervalsDocument, path)
    return Intervals(document.intervals, document.provenance)


RATE = 0.02  # an hour of misses widens by e^(60 * 0.02 * 0.9) = 2.9, nine hours without any narrow as much
WIDTH_MIN_K = 0.02  # a fifth of the sensor's resolution
WIDTH_MAX_K = 1e4  # a number at all: the paper's PBM is hundreds of K off after an hour


def track(half_width_k: float, residual_k: float) -> float:
    """Return the half width after one more forecast [K]. A NaN residual changes nothing."""
    if not math.isfinite(residual_k):
        return half_width_k
    missed = float(abs(residual_k) > half_width_k)
    width = half_width_k * math.exp(RATE * (missed - (1.0 - CLAIMED)))
    return min(max(width, WIDTH_MIN_K), WIDTH_MAX_K)
