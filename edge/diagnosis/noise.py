"""Noise of a reading, and whether a recording begins at rest and in which room."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edge.formats.run_file import RecordedRun

Floats = NDArray[np.float64]
USUAL_ROOM_C, ABOVE_K = 24.0, 0.5  # of a run that begins warm: at most, and as much below its first reading
STILL_ROWS = 4  # at the begin of a run, that tell whether it rests
STILL_SHARE, COLD_SHARE = 0.01, 0.1  # of all that the air moves by: so still, so near its coldest
SDS = 3.0
SMALLER, OF_SMALLER = 0.6, 0.3966  # share of differences, and what it has for its mean in a normal variable
LEAST_K = 1e-3  # of a reading's noise: what is declared as none
RECURS = 3  # times, of a reading in steps


def rests(known: Floats, noise_k: float) -> bool:
    """Return whether the first readings stand still near the coldest of all. known : readings in a row"""
    moved_k, first = float(np.ptp(known)), known[:STILL_ROWS]
    is_still = float(np.ptp(first)) <= max(STILL_SHARE * moved_k, SDS * noise_k)
    return is_still and float(first[0]) <= float(known.min()) + max(COLD_SHARE * moved_k, SDS * noise_k)


def usual_room_c(temp: Floats, is_at_rest: bool) -> float:
    """Return the room where nobody measured it: what the air begins with, if that rests. temp : [N]"""
    first_c = float(temp[np.isfinite(temp)][:3].mean())
    return first_c if is_at_rest else min(first_c - ABOVE_K, USUAL_ROOM_C)


def reading_noise_k(runs: Sequence[RecordedRun]) -> float:
    """Return the noise of a reading as the recordings show it: by second differences, or by its steps.

    Their smaller ones leave out what inputs do. A reading in steps has at least their rounding's error; there
    a median would be a step or nothing, a mean is neither.
    """
    every = [run.columns["temp_air_c"][np.isfinite(run.columns["temp_air_c"])] for run in runs]
    second = np.sort(np.concatenate([np.abs(np.diff(known, 2)) for known in every]))
    spread_k = float(second[: math.ceil(SMALLER * len(second))].mean()) / OF_SMALLER / 6**0.5
    return max(spread_k, _step_k(np.concatenate(every)) / 12**0.5, LEAST_K)


def _step_k(known: Floats) -> float:
    """Return the distance of readings that recur; 0 where none do. Resampled rows lie between them."""
    values, counts = np.unique(np.round(known, 6), return_counts=True)
    order = np.argsort(-counts)
    usual = order[: int(np.searchsorted(np.cumsum(counts[order]), 0.5 * len(known))) + 1]
    often = np.sort(values[usual[counts[usual] >= RECURS]])
    return float(np.diff(often).min()) if len(often) > 1 else 0.0
