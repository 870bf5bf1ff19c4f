"""All rows with a known error of all runs as columns of one table, with what a regime may ask of a row."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.residuals import Residuals

Floats = NDArray[np.float64]
Whole = NDArray[np.intp]
LONG_AGO = 10**6  # rows since something that did not happen in the run
SLOPE_ROWS = 2  # either side of a row, over which the air's slope is taken
INPUTS = ("duty", "fan", "ambient", "excess_k", "light", "rel_humidity")


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """R rows. Arrays are [R].

    run : index of each row's run; row : its place in the run
    error_k : of the free run; heat_w : residual heat; slope_k_min : how fast the air warms
    inputs : those of INPUTS, and `utc_s`, that every run has
    switches : rows since `heater on`, `heater off`, `fan on`, `fan off`, 0 in its own
    """

    names: tuple[str, ...]
    step_s: float
    run: Whole
    row: Whole
    error_k: Floats
    heat_w: Floats
    slope_k_min: Floats
    inputs: dict[str, Floats]
    switches: dict[str, Whole]


def rows_of(runs: Sequence[Residuals]) -> Rows:
    """Return the rows of which the error is known. Errors: ValueError without a run"""
    kept = [np.isfinite(run.free_run_k) & np.isfinite(run.heat_w) for run in runs]
    places = [np.flatnonzero(keep) for keep in kept]

    def column(values: Sequence[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate([part[keep] for part, keep in zip(values, kept, strict=True)])

    inputs = {key: [getattr(run, key) for run in runs] for key in INPUTS}
    inputs["utc_s"] = [run.utc_s for run in runs]
    active = {"heater": [run.duty > 0.0 for run in runs], "fan": [run.fan > 0.0 for run in runs]}
    return Rows(
        tuple(run.name for run in runs),
        runs[0].step_s,
        np.repeat(np.arange(len(runs)), [len(place) for place in places]),
        np.concatenate(places),
        column([run.free_run_k for run in runs]),
        column([run.heat_w for run in runs]),
        column([_slope(run) for run in runs]),
        # A signal counts where every run has it: part of the rows would compare two sets of runs.
        {key: column(parts) for key, parts in inputs.items() if all(part is not None for part in parts)},
        {
            f"{actuator} {way}": column([_since(part == (way == "on")) for part in parts])
            for actuator, parts in active.items()
            for way in ("on", "off")
        },
    )


def _since(wanted: NDArray[np.bool_]) -> Whole:
    """Rows since it last became true; LONG_AGO while it is not, or has been so from the start."""
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
