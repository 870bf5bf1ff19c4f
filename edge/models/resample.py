"""Rows at one period from rows at any times."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from edge.errors import DataError

Floats = NDArray[np.float64]
HELD = ("heater_duty", "fan_on", "led", "light")  # row k's value holds from its time to the next


def resample(columns: Mapping[str, Floats], step_s: float) -> dict[str, Floats]:
    """The columns of a run at 0, step_s, 2 step_s, ...

    Held columns become their mean over each step; all others are taken between their two neighbours, NaN
    where those are more than one new or three usual periods apart (a gap stays a gap).
    Raises : DataError when `time_s` does not rise or the run is shorter than a step
    """
    time_s = columns["time_s"] - columns["time_s"][0]
    if not (np.diff(time_s) > 0.0).all():
        row = int(np.argmax(~(np.diff(time_s) > 0.0))) + 1
        raise DataError(f"time_s: row {row + 1} does not come after the one before")
    if not time_s[-1] >= step_s:
        raise DataError(f"time_s: {time_s[-1]:g} s are shorter than a step of {step_s:g} s")
    at = np.arange(0.0, time_s[-1] + 1e-6, step_s)
    gap_s = max(step_s, 3.0 * float(np.median(np.diff(time_s))))
    resampled = {
        key: _means(time_s, values, at, step_s) if key in HELD else _between(time_s, values, at, gap_s)
        for key, values in columns.items()
        if key != "time_s"
    }
    return {"time_s": at, **resampled}


def _means(time_s: Floats, values: Floats, at: Floats, step_s: float) -> Floats:
    """Mean over [at, at + step_s) of values that hold until the next row; NaN touches only its own steps."""
    known = np.isfinite(values)
    spans = np.diff(time_s, append=time_s[-1] + step_s)
    area = np.concatenate([[0.0], np.cumsum(np.where(known, values, 0.0) * spans)])
    unknown = np.concatenate([[0.0], np.cumsum(np.where(known, 0.0, spans))])
    edges = np.append(time_s, time_s[-1] + step_s)
    over = np.interp(at + step_s, edges, area) - np.interp(at, edges, area)
    lost = np.interp(at + step_s, edges, unknown) - np.interp(at, edges, unknown)
    return np.where(lost > 1e-9, np.nan, over / step_s)


def _between(time_s: Floats, values: Floats, at: Floats, gap_s: float) -> Floats:
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(at), np.nan)
    times = time_s[known]
    after = np.searchsorted(times, at - 1e-9).clip(0, len(times) - 1)
    before = np.searchsorted(times, at + 1e-9, side="right").clip(1, None) - 1
    near = (times[after] - times[before] <= gap_s) & (times[0] <= at + 1e-9) & (at <= times[-1] + 1e-9)
    return np.where(near, np.interp(at, times, values[known]), np.nan)
