"""Inputs of a diagnosis: cleaned training runs as arrays, the ambient over each row, doors, and the given
twin.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.diagnosis.fitting import fit
from edge.diagnosis.free_fit import fit_values
from edge.diagnosis.gap import forecast
from edge.diagnosis.locate.events import DoorOpening, find_events
from edge.diagnosis.noise_levels import find_levels, first_levels
from edge.diagnosis.nuisances import answer_s, assumed_room, begins_at_rest, nuisances, rooms
from edge.diagnosis.readings import expected_readings, spikes, stuck_readings, wrong_starts
from edge.diagnosis.runs import DiagnosisRuns, NamedRun
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import FittedTwin, SizedTerm, Trial
from edge.twin.run_batch import RunBatch, batch_runs
from edge.twin.twin_file import TwinFile
from edge.twin.warm_start import hold

Floats = NDArray[np.float64]
RATIOS = np.logspace(-3.0, 2.0, 16)  # wander between two rows over the noise of a reading, variances
LEAST_ROWS = 10


def smooth(ambient: Floats) -> Floats:
    """Return the ambient without the noise of its readings. ambient : [B, N], without holes

    A random walk seen through white noise (local level model; Harvey 1989, Forecasting, ch. 2), the ratio of
    the two by maximum likelihood over all runs.
    """
    from scipy.linalg import solveh_banded

    rows = ambient.shape[1]
    if rows < LEAST_ROWS or not np.ptp(ambient, axis=1).any():
        return ambient
    ratio = RATIOS[int(np.argmax(_log_likelihoods(ambient, RATIOS)))]
    bands = np.zeros((2, rows))
    bands[1] = 1.0 + 2.0 / ratio
    bands[1, [0, -1]] = 1.0 + 1.0 / ratio
    bands[0, 1:] = -1.0 / ratio
    return np.asarray(solveh_banded(bands, ambient.T).T)


def _log_likelihoods(values: Floats, ratios: Floats) -> Floats:
    """Return the log likelihood of each ratio, up to a constant, at the best noise size."""
    level = np.repeat(values[:, 0][None], len(ratios), axis=0)
    variance, square, spread = np.ones(len(ratios)), np.zeros(len(ratios)), np.zeros(len(ratios))
    for reading in values.T[1:]:
        variance = variance + ratios
        total = variance + 1.0
        error = reading - level
        level += (variance / total)[:, None] * error
        variance /= total
        square += (error**2).sum(axis=1) / total
        spread += np.log(total)
    count = values.size - len(values)
    return -0.5 * (count * np.log(np.maximum(square, 1e-12) / count) + len(values) * spread)


def between(ambient: Floats) -> Floats:
    """In the middle of each row: half way to the next reading; ambient : [B, N]."""
    return np.concatenate([0.5 * (ambient[:, 1:] + ambient[:, :-1]), ambient[:, -1:]], axis=1)


WAYS = {"held": lambda ambient: ambient, "between": between}  # how the room goes from reading to reading


def over_rows(ambient: Floats, way: str) -> Floats:
    """Return the ambient over each row, [B, N]."""
    return np.asarray(WAYS[way](smooth(ambient)))


ITERATIONS, FEW = 6, 3
FAR_OFF = 3.0  # times a reading's noise: what a twin expects is then worse than the reading


@dataclass(frozen=True, slots=True, eq=False)
class PreparedRuns:
    """The twin as given, with `day0_utc` where the runs tell it, and the runs.

    train : the training runs, without a first reading that is wrong
    runs : they without wrong readings, with a room temperature, and with doors as a condition where any were
        found
    guessed : whether no room temperature was recorded: `runs` has one constant per run that fits the twin
    wrong : readings taken out
    room : how the room goes from one reading to the next, of `edge.diagnosis.prepare.WAYS`; "" if guessed
    expected : the air without its reading's noise, [B, N + 1] [°C]
    """

    file: TwinFile
    train: tuple[NamedRun, ...]
    runs: RunBatch
    terms: tuple[SizedTerm, ...]
    doors: tuple[DoorOpening, ...]
    wrong: int
    guessed: bool
    expected: Floats
    room: str

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the training runs."""
        return tuple(named.name for named in self.train)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about the data that were taken out."""
        if not self.wrong:
            return ()
        count = "1 temperature" if self.wrong == 1 else f"{self.wrong} temperatures"
        return (f"{count} of the training runs can't be what the air had and counted as missing",)

    def as_fitted(self) -> tuple[NamedRun, ...]:
        """Return the training runs without wrong readings, with the doors that were found as `door_open`."""
        return tuple(self._as_fitted(i, named) for i, named in enumerate(self.train))

    def _as_fitted(self, i: int, named: NamedRun) -> NamedRun:
        columns = dict(named.run.columns)
        known = np.flatnonzero(np.isfinite(columns["temp_air_c"]))
        first, last = int(known[0]), int(known[-1])  # the rows that `batch_runs` takes
        columns["temp_air_c"] = np.full(len(named.run), np.nan)
        columns["temp_air_c"][first : last + 1] = self.runs.temp[i, : last + 1 - first]
        if self.doors:
            columns["door_open"] = np.zeros(len(named.run))
            columns["door_open"][first:last] = self.runs.conditions["door_open"][i, : last - first]
        return replace(named, run=replace(named.run, columns=columns))

    def room_of(self, named: NamedRun) -> Floats:
        """Return the ambient temperature over each row of a run, [rows].

        Where none was recorded, of a run that was not fitted on: where it begins at rest, as far from its
        first temperature as those that did were, as long as it begins no warmer nor colder than they; else
        the mean of theirs.
        """
        rows = len(named.run)
        if not self.guessed:
            return np.asarray(over_rows(hold(named.run.columns["temp_ambient_c"])[None], self.room)[0])
        own = named.rest_of or named.name
        if own in self.names:
            return np.full(rows, self.runs.ambient[self.names.index(own), 0])
        readings, fitted = named.run.columns["temp_air_c"], self.runs.ambient[:, 0]
        at_rest = np.array([begins_at_rest(temps) for temps in self.runs.temp])
        if not at_rest.any() or not begins_at_rest(readings):
            return np.full(rows, fitted.mean())
        known = self.runs.temp[at_rest, 0]
        first = np.clip(readings[np.isfinite(readings)][0], known.min(), known.max())
        return np.full(rows, first + np.mean(fitted[at_rest] - known))


def prepare(file: TwinFile, data: DiagnosisRuns) -> PreparedRuns:
    """Prepare the training runs. Errors: DataError for a column that the twin needs and the runs have not"""
    item = _prepare(_begun_well(file, data), data.train)
    best = _fit(item)
    wrong = wrong_starts(best, item.runs)
    if wrong.any():
        train = [_begun_later(named) if bad else named for named, bad in zip(data.train, wrong, strict=True)]
        item = _prepare(item.file, train)
        item = replace(item, wrong=item.wrong + int(wrong.sum()))
        best = _fit(item)
    return _without_events(item, best)


def _begun_well(file: TwinFile, data: DiagnosisRuns) -> TwinFile:
    """With its open values where free runs fit best, wherever they were to start, and its speed."""
    if not file.to_fit():
        return replace(file, answer_s=answer_s(file.twin()))
    plain = _prepare(file, data.train)
    rooms = [term for term in plain.terms if term.of_room]
    best = fit_values([file], rooms, plain.runs, first_levels(file, plain.runs).sensor_k, SideBySide())[
        0
    ].file
    found = {place: value for place, value in best.values().items() if file.values()[place].fit}
    return replace(file.with_values(found), answer_s=answer_s(best.twin()))


def _begun_later(named: NamedRun) -> NamedRun:
    """Return the run without its first reading."""
    temp = named.run.columns["temp_air_c"].copy()
    temp[np.isfinite(temp).argmax()] = np.nan
    return replace(named, run=replace(named.run, columns={**named.run.columns, "temp_air_c": temp}))


def _prepare(file: TwinFile, train: Sequence[NamedRun]) -> PreparedRuns:
    """Without what is wrong on its face, and with a room temperature."""
    runs = batch_runs([named.run for named in train], file.sample_s)
    if file.day0_utc is None and "utc" in runs.conditions:
        file = replace(file, day0_utc=float(runs.conditions["utc"].min()))
    guessed = not runs.has_ambient
    if guessed:
        assumed = np.array([[assumed_room(temps)] for temps in runs.temp])
        runs = replace(runs, ambient=np.repeat(assumed, runs.duty.shape[1], axis=1))
    wrong = stuck_readings(runs)
    wrong |= spikes(replace(runs, temp=np.where(wrong, np.nan, runs.temp)))
    runs = replace(runs, temp=np.where(wrong, np.nan, runs.temp))
    terms = rooms(runs) if guessed else nuisances(file, runs, runs.temp)
    plain = PreparedRuns(file, tuple(train), runs, terms, (), int(wrong.sum()), guessed, runs.temp, "")
    return plain if guessed else _with_room(plain)


def _with_room(item: PreparedRuns) -> PreparedRuns:
    """With the room over each row, in the way that explains the runs better before anything is added."""
    ways = [
        replace(item, runs=replace(item.runs, ambient=over_rows(item.runs.ambient, way)), room=way)
        for way in WAYS
    ]
    return max(ways, key=lambda way: _fit(way, FEW).log_likelihood)


def _fit(item: PreparedRuns, iterations: int = ITERATIONS) -> FittedTwin:
    """Fit the twin before any effect is added."""
    trial = Trial(item.file, first_levels(item.file, item.runs), item.terms)
    levelled = find_levels(fit([trial], item.runs, iterations), item.file, item.runs)
    return fit(levelled, item.runs, FEW)[0]


def _with_expected(item: PreparedRuns, best: FittedTwin) -> PreparedRuns:
    """With what the twin expected of each temperature, which has nothing of the readings' own noise.

    A twin that lacks much expects nonsense: then the readings stand for the air, noise and all.
    """
    temps = expected_readings(best, item.runs)
    off_k = np.sqrt(np.nanmean((temps - item.runs.temp) ** 2))
    if not off_k <= FAR_OFF * first_levels(item.file, item.runs).sensor_k:
        return item
    terms = item.terms if item.guessed else nuisances(item.file, item.runs, temps)
    return replace(item, expected=temps, terms=terms)


def _without_events(plain: PreparedRuns, best: FittedTwin) -> PreparedRuns:
    """Find doors and wrong readings by the twin as it fits best before anything is added."""
    known = with_rooms(plain, best.sizes)
    try:
        events = find_events(best.file.twin(), known.runs, plain.names, best.trial.levels.sensor_k)
    except (DataError, np.linalg.LinAlgError):
        return _with_expected(plain, best)  # a twin that is so far off has no events to tell
    if not events.doors and not events.wrong.any():
        return _with_expected(plain, best)
    temp = np.where(events.wrong, np.nan, plain.runs.temp)
    temp[:, 0] = plain.runs.temp[:, 0]  # a run's first reading is where it begins
    runs = replace(plain.runs, temp=temp)
    if events.doors:
        recorded_doors = runs.conditions.get("door_open", np.zeros_like(runs.duty))
        door_open = np.maximum(recorded_doors, events.door_open)
        runs = replace(runs, conditions={**runs.conditions, "door_open": door_open})
    wrong = int(np.isfinite(plain.runs.temp).sum() - np.isfinite(temp).sum())
    clean = replace(plain, runs=runs, doors=events.doors, wrong=plain.wrong + wrong)
    return _with_expected(clean, _fit(clean))


def with_rooms(item: PreparedRuns, sizes: Sequence[float] | Floats) -> PreparedRuns:
    """With the fitted constant as room temperature, where none was recorded."""
    if not item.guessed:
        return item
    offsets = np.array([size for term, size in zip(item.terms, sizes, strict=False) if term.of_room])
    return replace(item, runs=replace(item.runs, ambient=item.runs.ambient + offsets[:, None]))


def errors_over(tests: Sequence[NamedRun], fitted: FittedTwin, known: PreparedRuns) -> Floats:
    """Measured minus free run over all test runs, one after another, NaN where not measured [K]."""
    own = with_rooms(known, fitted.sizes)
    twin = fitted.file.twin()
    missed = [forecast(twin, named, own.room_of(named)).residual for named in tests]
    return np.concatenate([np.empty(0), *missed])
