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
# Of a working point: rows that it lasts, duty that holds it, and that as a share of the duty that warms it.
HELD_ROWS, HELD_DUTY, HELD_SHARE = 20, 0.02, 0.8
SDS = 3.0
SMALLER, OF_SMALLER = 0.6, 0.3966  # share of differences, and what it has for its mean in a normal variable
LEAST_K = 1e-3  # of a reading's noise: what is declared as none
RECURS = 3  # times, of a reading in steps


def rests(temp: Floats, duty: Floats, noise_k: float) -> bool:
    """Return whether a run begins in balance with its room: still, near its coldest, and not held there.

    temp : [N] [°C], NaN where not measured; duty : [N] or [N - 1]
    """
    seen = np.isfinite(temp)
    known = temp[seen]
    moved_k, first = float(np.ptp(known)), known[:STILL_ROWS]
    still_k, cold_k = (max(share * moved_k, SDS * noise_k) for share in (STILL_SHARE, COLD_SHARE))
    if float(np.ptp(first)) > still_k or float(first[0]) > float(known.min()) + cold_k:
        return False
    # What is warmed only by more heat than it had at first was held by that at a working point.
    begin = int(seen.argmax())
    warmer = np.nan_to_num(temp[begin:], nan=-np.inf) > float(first[0]) + still_k
    still = int(np.append(warmer, True).argmax())
    at_first, later = duty[begin:][: still // 2], duty[begin:][still // 2 : still + still // 2]
    if still < HELD_ROWS or float(at_first[:STILL_ROWS].min()) <= HELD_DUTY:
        return True
    return bool(warmer.any() and at_first.mean() > HELD_SHARE * later.mean())


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
