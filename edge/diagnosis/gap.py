"""How far a twin's free runs are from what was measured, run by run and together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.diagnosis.diagnosis_document import GapErrors, RunErrors
from edge.diagnosis.noise import reading_noise_k, rests, usual_room_c
from edge.diagnosis.prepare import PreparedRuns, over_rows
from edge.diagnosis.runs import NamedRun, has_column
from edge.diagnosis.twin_choice import FIRST_ROWS
from edge.diagnosis.twin_fit import FitRuns, FittedTwin, best_starts
from edge.formats.run_file import RecordedRun, inside_names
from edge.twin.rollout import Commands
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile
from edge.twin.warm_start import hold

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RunForecast:
    """A free run of a twin over one run.

    start : the row that it is judged from; measured : [rows] [°C], NaN where the recording has no row
    predicted : [rows] [°C]; room_c : [rows], over each row
    """

    name: str
    start: int
    measured: Floats
    predicted: Floats
    room_c: Floats

    @property
    def residual(self) -> Floats:
        """Measured minus predicted behind the start, NaN where not measured."""
        return (self.measured - self.predicted)[self.start + 1 :]


def forecasts(fit: FittedTwin, names: Sequence[NamedRun], known: PreparedRuns) -> tuple[RunForecast, ...]:
    """Run a fitted twin over training or test runs."""
    return tuple(_forecast(fit, named, known) for named in names)


def _forecast(fit: FittedTwin, named: NamedRun, known: PreparedRuns) -> RunForecast:
    """Run a fitted twin over one run.

    A training run begins where its fit has it. Any other begins in balance with its first readings where it
    rests, or as its rows before the judged part, or its first ones, tell.
    """
    own = named.rest_of or named.name
    place = known.names.index(own) if own in known.names else None
    temp = named.run.columns["temp_air_c"]
    first, size = int(np.isfinite(temp).argmax()), len(fit.file.twin().states)
    is_at_rest = rests(temp, hold(named.run.columns["heater_duty"]), known.noise_k)
    if has_column(named.run, "temp_ambient_c"):
        room_c = over_rows(hold(named.run.columns["temp_ambient_c"])[None])[0]
    elif place is not None and known.open_rooms[place]:
        room_c = np.full(len(temp), fit.starts[place, -1])
    elif is_at_rest:
        room_c = np.full(len(temp), usual_room_c(temp, True))
    else:
        rooms = fit.starts[known.open_rooms, -1] if known.guessed else known.runs.ambient.mean(axis=1)
        room_c = np.full(len(temp), float(rooms.mean()))
    columns = columns_of(named.run, room_c)
    if place is None:
        state, start = _start(fit.file, named, columns, first, known.noise_k, fit.error_k)
        shown = _run(fit.file, columns, first, state)
    else:
        power, heat = fit.starts[place, size : size + 2]
        shown = _run(fit.file, columns, first, fit.starts[place, :size], power, heat)
        start = first
        if named.from_s is not None:
            start = max(first, int((named.run.columns["time_s"] < named.from_s).sum()) - 1)
    measured = np.where(named.recorded, temp, np.nan)
    if named.name in known.names:  # without readings that were wrong
        rows = known.runs.temp[known.names.index(named.name)]
        count = min(len(rows), len(temp) - first)
        measured[first : first + count][~np.isfinite(rows[:count])] = np.nan
    return RunForecast(named.name, start, measured, shown, room_c)


def predict(file: TwinFile, named: NamedRun, room_c: Floats) -> Floats:
    """Return a free run of a known twin from the first reading on, [rows] [°C]. room_c : [rows]"""
    columns = columns_of(named.run, room_c)
    first = int(np.isfinite(columns["temp_air"]).argmax())
    noise_k = reading_noise_k([named.run])
    state, _ = _start(file, named, columns, first, noise_k, noise_k)
    return _run(file, columns, first, state)


def _run(
    file: TwinFile,
    columns: dict[str, Floats],
    first: int,
    state: Floats,
    power: float = 0.0,
    heat: float = 0.0,
) -> Floats:
    """power, heat : of this run, off the usual, as shares of the heater's power"""
    twin = file.twin()
    ahead = {name: values[None, first:-1] for name, values in columns.items() if name != "temp_air"}
    predicted = twin.rollout(
        state,
        (1.0 + power) * ahead["heater_duty"],
        ahead["fan_on"],
        ahead["temp_ambient"],
        heat * twin.geometry.heater_max_w / twin.system.air_capacity_j_k,
        conditions=ahead,
        before=Commands(np.zeros(0), np.zeros(0)),
    )[0]
    return np.concatenate([np.full(first, np.nan), state[:1], predicted])


def _start(
    file: TwinFile, named: NamedRun, columns: dict[str, Floats], first: int, noise_k: float, error_k: float
) -> tuple[Floats, int]:
    """Return the state of a run's first row, and the last row that told of it."""
    temp = columns["temp_air"]
    is_at_rest = rests(temp, columns["heater_duty"], noise_k)
    seen = np.isfinite(temp[first + 1 :])
    if named.from_s is not None:
        seen &= named.run.columns["time_s"][first + 1 :] < named.from_s
    elif is_at_rest:
        seen[:] = False
    else:
        seen[FIRST_ROWS:] = False
    start = first + 1 + int(np.flatnonzero(seen)[-1]) if seen.any() else first
    inputs = {name: values[None, first:-1] for name, values in columns.items() if name != "temp_air"}
    duty, fan, room = (inputs[name] for name in ("heater_duty", "fan_on", "temp_ambient"))
    batch = RunBatch(temp[None, first:], duty, fan, room, inputs)
    runs = FitRuns(batch, noise_k, np.array([is_at_rest]), np.zeros(1, dtype=bool))
    return best_starts(file, runs, seen[None], error_k)[0], start


def columns_of(run: RecordedRun, room_c: Floats) -> dict[str, Floats]:
    """Return a run's columns by their internal names, inputs and conditions without holes."""
    columns = {name: np.asarray(values, dtype=np.float64) for name, values in inside_names(run).items()}
    rows = len(run)
    columns.setdefault("fan_on", np.zeros(rows))
    columns["temp_ambient"] = room_c
    return {name: values if name == "temp_air" else hold(values) for name, values in columns.items()}


def known_errors(found: Sequence[RunForecast]) -> GapErrors:
    """Return the errors. Errors : DataError without any measured row to compare with"""
    every = errors(found)
    if every is None:
        raise DataError("diagnosis: the training runs have no measured row to compare a free run with")
    return every


def errors(found: Sequence[RunForecast]) -> GapErrors | None:
    """Return the errors over all runs and of each, None without any measured row to compare with."""
    every = [(item.name, item.residual[np.isfinite(item.residual)]) for item in found]
    every = [(name, residual) for name, residual in every if len(residual)]
    if not every:
        return None
    return {
        **_error(np.concatenate([residual for _, residual in every])),
        "per_run": {name: _error(residual) for name, residual in every},
    }


def _error(residual: Floats) -> RunErrors:
    return {"rmse_k": float(np.sqrt(np.mean(residual**2))), "mae_k": float(np.mean(np.abs(residual)))}
