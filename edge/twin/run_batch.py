"""Recorded runs as arrays that a twin can be run over, all at once."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun, refuse_test, resample
from edge.twin.signals import Conditions
from edge.twin.warm_start import hold

Floats = NDArray[np.float64]
CONDITIONS = {
    "light": "light",
    "rel_humidity_pct": "rel_humidity",
    "door_open": "door_open",
    "solar_w_m2": "solar",
}


@dataclass(frozen=True, slots=True, eq=False)
class RunBatch:
    """B runs, padded to the longest with missing temperatures; row k's inputs hold to row k + 1.

    temp : [B, N + 1], NaN where missing [°C]; duty, fan, ambient : [B, N]
    ambient : NaN in runs whose room nobody measured
    conditions : [B, N] each, columns of CONDITIONS that every run has, held over holes
    """

    temp: Floats
    duty: Floats
    fan: Floats
    ambient: Floats
    conditions: Conditions = field(default_factory=dict)

    @property
    def has_ambient(self) -> bool:
        """True if every run has its ambient temperature."""
        return bool(np.isfinite(self.ambient).all())

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Rows after which a temperature was measured, [B, N]: a model is fitted to these."""
        return np.isfinite(self.temp[:, 1:])


def batch_runs(runs: Sequence[RecordedRun], step_s: float) -> RunBatch:
    """Return the runs as arrays at `step_s` that a model may be fitted on.

    A run ends where its fact `validate_from_s` says that validation begins; a fan column that is absent is a
    fan that stood still; a room temperature is held over its holes.

    Errors : DataError for a run of role test, or one with no temperature
    """
    if not runs:
        raise DataError("fit: needs at least one run")
    parts = [_part(run, step_s) for run in runs]
    rows = max(part.temp.shape[1] for part in parts)
    return RunBatch(
        np.concatenate([_pad(part.temp, rows, np.nan) for part in parts]),
        np.concatenate([_pad(part.duty, rows - 1, 0.0) for part in parts]),
        np.concatenate([_pad(part.fan, rows - 1, 0.0) for part in parts]),
        np.concatenate([_pad(part.ambient, rows - 1, part.ambient[0, -1]) for part in parts]),
        {
            name: np.concatenate([_held_on(part.conditions[name], rows - 1) for part in parts])
            for name in parts[0].conditions
            if all(name in part.conditions for part in parts)
        },
    )


def _part(run: RecordedRun, step_s: float) -> RunBatch:
    refuse_test(run)
    columns = resample(run, step_s).columns
    rows = len(columns["time_s"])
    if "validate_from_s" in run.facts:
        rows = int((columns["time_s"] < _seconds(run)).sum())
    temp = columns["temp_air_c"][:rows]
    known = np.flatnonzero(np.isfinite(temp))
    if len(known) < 2:
        raise DataError(f"{run.path}: temp_air_c: fewer than two temperatures to fit on")
    begin, end = known[0], known[-1]
    duty, fan = columns["heater_duty"], columns.get("fan_on", np.zeros(len(columns["time_s"])))
    ambient = columns.get("temp_ambient_c", np.full(len(fan), np.nan))
    steps = slice(begin, end)
    return RunBatch(
        temp[None, begin : end + 1],
        duty[None, steps],
        fan[None, steps],
        hold(ambient)[None, steps],
        {name: hold(values)[None, steps] for name, values in _conditions(run, columns).items()},
    )


def _conditions(run: RecordedRun, columns: Conditions) -> Conditions:
    """Return the run's columns that effects may need, by their internal
    names, with the time where it is known.
    """
    found = {name: columns[key] for key, name in CONDITIONS.items() if key in columns}
    if run.start_utc is not None:
        found["utc"] = run.start_utc + columns["time_s"]
    return found


def _seconds(run: RecordedRun) -> float:
    try:
        return float(run.facts["validate_from_s"])
    except ValueError:
        raise DataError(
            f"{run.path}: validate_from_s: {run.facts['validate_from_s']!r} is no number"
        ) from None


def _held_on(values: Floats, columns: int) -> Floats:
    return np.pad(values, ((0, 0), (0, columns - values.shape[1])), mode="edge")


def _pad(values: Floats, columns: int, with_value: float) -> Floats:
    missing = ((0, 0), (0, columns - values.shape[1]))
    return np.pad(values, missing, constant_values=with_value)
