"""How far a twin's free runs are from what was measured, run by run and together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.diagnosis.diagnosis_document import GapErrors, RunErrors
from edge.diagnosis.innovations import FilterInput, NoiseLevels, gains, whiten
from edge.diagnosis.runs import NamedRun
from edge.diagnosis.trial import start_of, start_spread
from edge.formats.run_file import RecordedRun, inside_names
from edge.twin.linearise import EnsembleRun, linearise, responses
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import PastColumns, hold, state_now

Floats = NDArray[np.float64]
START_ROWS = 10  # of a run that may be known before the forecast begins


@dataclass(frozen=True, slots=True, eq=False)
class RunForecast:
    """A free run of a twin over one run.

    start : the row that it begins from, the last measured one of the first rows
    measured : [rows] [°C], NaN where the recording has no row
    predicted : [rows] [°C], as measured up to `start`
    """

    name: str
    start: int
    measured: Floats
    predicted: Floats

    @property
    def residual(self) -> Floats:
        """Measured minus predicted behind the start, NaN where not measured."""
        return (self.measured - self.predicted)[self.start + 1 :]


def forecast(twin: BoxTwin, named: NamedRun, room_c: Floats) -> RunForecast:
    """From the first measured rows of a run on, with the inputs that were recorded.

    room_c : the room temperature over each row, [rows]
    """
    columns = columns_of(named.run, room_c)
    temp = columns["temp_air"]
    start = _start_row(temp, named)
    known = {name: values for name, values in columns.items() if name != "temp_air"}
    before = {name: values[: start + 1] for name, values in known.items()}
    past = PastColumns(
        temp[: start + 1], before["temp_ambient"], before["heater_duty"], before["fan_on"], conditions=before
    )
    ahead = {name: values[None, start:-1] for name, values in known.items()}
    predicted = twin.rollout(
        state_now(twin, past),
        ahead["heater_duty"],
        ahead["fan_on"],
        ahead["temp_ambient"],
        conditions=ahead,
        before=Commands(past.duty[:-1], past.fan[:-1]),
    )[0]
    measured = np.where(named.recorded, temp, np.nan)
    return RunForecast(named.name, start, measured, np.concatenate([hold(temp[: start + 1]), predicted]))


def columns_of(run: RecordedRun, room_c: Floats) -> dict[str, Floats]:
    """Return a run's columns by their internal names, inputs and conditions without holes."""
    columns = {name: np.asarray(values, dtype=np.float64) for name, values in inside_names(run).items()}
    rows = len(run)
    columns.setdefault("fan_on", np.zeros(rows))
    columns["temp_ambient"] = room_c
    return {name: values if name == "temp_air" else hold(values) for name, values in columns.items()}


def _start_row(temp: Floats, named: NamedRun) -> int:
    """Return the row from which the free run begins. A run with a scored part begins at the last measured row
    before that part. Any other begins at the last of the first rows that follow the first reading without a
    hole.
    """
    known = np.isfinite(temp)
    if named.from_s is not None:
        before = known & (named.run.columns["time_s"] < named.from_s)
        if before.any():
            return int(np.flatnonzero(before)[-1])
    first = int(known.argmax())
    row = first
    while row + 1 < min(first + START_ROWS, len(temp) - 1) and known[row + 1]:
        row += 1
    return row


def alone(named: NamedRun, guess: RunForecast, room_c: Floats) -> RunBatch:
    """One run as arrays, missing temperatures as in its free run."""
    columns = columns_of(named.run, room_c)
    temp = np.where(np.isfinite(columns["temp_air"]), columns["temp_air"], guess.predicted)
    inputs = {name: values[None, :-1] for name, values in columns.items() if name != "temp_air"}
    return RunBatch(temp[None], inputs["heater_duty"], inputs["fan_on"], inputs["temp_ambient"], inputs)


def one_step(twin: BoxTwin, levels: NoiseLevels, runs: RunBatch, seen: NDArray[np.bool_]) -> Floats:
    """Predict each row's temperature from all readings before it [rows]. seen : [rows]"""
    steps = linearise(twin, runs)
    filters = gains([FilterInput(steps, levels, start_spread(twin, runs), twin.step_s)], seen[None, 1:])
    shown = responses([EnsembleRun(steps, start_of(twin, runs), steps.driven)])
    error = runs.temp[None, :, 1:] - shown
    white = whiten(filters, np.array([0]), error, everywhere=True)[0, 0]
    return np.concatenate([runs.temp[0, :1], runs.temp[0, 1:] - white * filters.sd[:, 0, 0]])


def floor_squares(twin: BoxTwin, levels: NoiseLevels, runs: RunBatch, seen: NDArray[np.bool_]) -> Floats:
    """Variance of what a free run of the right twin misses by in each measured row of one run [K2].

    Sensor and room noise, unknown heat and mains power, from a start that is known.
    """
    steps = linearise(twin, runs)
    known = FilterInput(steps, levels, np.zeros(len(steps.states)), twin.step_s)
    filters = gains([known], np.zeros((1, runs.fan.shape[1]), dtype=bool))
    return np.asarray(filters.sd[seen[1:], 0, 0] ** 2)


def known_errors(forecasts: Sequence[RunForecast]) -> GapErrors:
    """Return the errors. Errors : DataError without any measured row to compare with"""
    found = errors(forecasts)
    if found is None:
        raise DataError("diagnosis: the training runs have no measured row to compare a free run with")
    return found


def errors(forecasts: Sequence[RunForecast]) -> GapErrors | None:
    """Return the errors over all runs and of each, None without any measured row to compare with."""
    every = [(item.name, item.residual[np.isfinite(item.residual)]) for item in forecasts]
    every = [(name, residual) for name, residual in every if len(residual)]
    if not every:
        return None
    return {
        **_error(np.concatenate([residual for _, residual in every])),
        "per_run": {name: _error(residual) for name, residual in every},
    }


def _error(residual: Floats) -> RunErrors:
    return {"rmse_k": float(np.sqrt(np.mean(residual**2))), "mae_k": float(np.mean(np.abs(residual)))}
