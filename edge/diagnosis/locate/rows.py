"""All counted rows of all runs as columns of one table, with what a regime may ask of a row."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.residuals import Residuals

Floats = NDArray[np.float64]
Whole = NDArray[np.intp]
LONG_AGO = 10**6  # rows since something that did not happen in the run
SLOPE_ROWS = 2  # either side of a row, over which the air's slope is taken
DAY_S, HOUR_S = 86400.0, 3600.0


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """R rows. Columns are [R]; light, rel_humidity and utc_s are None unless every run has them.

    run : index of each row's run; row : its place in the run
    error_k : of the free run; heat_w : residual heat
    slope_k_min : how fast the air warms
    heater_on_for, heater_off_for, fan_on_for, fan_off_for : rows since the switch, 0 in its own
    """

    names: tuple[str, ...]
    step_s: float
    run: Whole
    row: Whole
    error_k: Floats
    heat_w: Floats
    duty: Floats
    fan: Floats
    ambient: Floats
    excess_k: Floats
    slope_k_min: Floats
    heater_on_for: Whole
    heater_off_for: Whole
    fan_on_for: Whole
    fan_off_for: Whole
    light: Floats | None
    rel_humidity: Floats | None
    utc_s: Floats | None


def rows_of(runs: Sequence[Residuals]) -> Rows:
    """Return the rows of which the error is known. Errors: ValueError without a run"""
    kept = [run.counted for run in runs]

    def column(values: list[Floats]) -> Floats:
        return np.concatenate([part[keep] for part, keep in zip(values, kept, strict=True)])

    # A signal counts where every run has it: part of the rows would compare two sets of runs.
    def optional(values: list[Floats | None]) -> Floats | None:
        known = [value for value in values if value is not None]
        return column(known) if len(known) == len(values) else None

    def since(values: list[Floats], on: bool) -> Whole:
        return column([_since(part > 0.0, on).astype(np.float64) for part in values]).astype(np.intp)

    duties, fans = [run.duty for run in runs], [run.fan for run in runs]
    return Rows(
        tuple(run.name for run in runs),
        runs[0].step_s,
        np.repeat(np.arange(len(runs)), [int(keep.sum()) for keep in kept]),
        np.concatenate([np.flatnonzero(keep) for keep in kept]),
        column([run.free_run_k for run in runs]),
        column([run.heat_w for run in runs]),
        column(duties),
        column(fans),
        column([run.ambient for run in runs]),
        column([run.excess_k for run in runs]),
        column([_slope(run) for run in runs]),
        since(duties, on=True),
        since(duties, on=False),
        since(fans, on=True),
        since(fans, on=False),
        optional([run.light for run in runs]),
        optional([run.rel_humidity for run in runs]),
        optional([None if run.start_utc is None else run.start_utc + run.time_s for run in runs]),
    )


def _since(active: NDArray[np.bool_], on: bool) -> Whole:
    """Rows since it last went on (or off); LONG_AGO while it is the other, or has been so from the start."""
    wanted = active if on else ~active
    went = np.flatnonzero(wanted[1:] & ~wanted[:-1]) + 1
    newest = np.searchsorted(went, np.arange(len(wanted)), side="right") - 1
    last = np.where(newest >= 0, went[np.maximum(newest, 0)] if len(went) else 0, -LONG_AGO)
    return np.where(wanted, np.minimum(np.arange(len(wanted)) - last, LONG_AGO), LONG_AGO)


def _slope(run: Residuals) -> Floats:
    """Central over SLOPE_ROWS either side [K/min]."""
    places = np.arange(len(run.air_c))
    later = np.minimum(places + SLOPE_ROWS, len(places) - 1)
    before = np.maximum(places - SLOPE_ROWS, 0)
    minutes = np.maximum(later - before, 1) * run.step_s / 60.0
    return np.asarray((run.air_c[later] - run.air_c[before]) / minutes)
