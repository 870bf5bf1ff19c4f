"""Inputs of a diagnosis: clean rows at one step, the room over each row, and the given twin where it fits."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.baselines import LOSING, STORING
from edge.diagnosis.noise import LEAST_K, reading_noise_k, rests, usual_room_c
from edge.diagnosis.progress import Telling
from edge.diagnosis.readings import spikes, stuck_readings, wrong_first
from edge.diagnosis.runs import DiagnosisRuns, NamedRun
from edge.diagnosis.seeds import first_twin
from edge.diagnosis.twin_fit import POWER_SD, FitRuns
from edge.twin.run_batch import RunBatch, batch_runs
from edge.twin.twin_file import TwinFile

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
RATIOS = np.logspace(-3.0, 2.0, 16)  # wander between two rows over the noise of a reading, variances
LEAST_ROWS = 10
LEAST_SD = 1e-4  # of a power: what is declared as none


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


def over_rows(ambient: Floats) -> Floats:
    """Return the ambient over each row, half way to the next reading, [B, N]."""
    smoothed = smooth(ambient)
    return np.concatenate([0.5 * (smoothed[:, 1:] + smoothed[:, :-1]), smoothed[:, -1:]], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedRuns:
    """The twin, with what it leaves open where one mass fits, and the training runs.

    file : at the step of the runs; given : as it was given
    runs : without wrong readings; its room a guessed constant in runs where nobody measured it
    rests : [B], runs that begin in balance with their rooms
    wrong : readings taken out; open_rooms : [B], runs whose room nobody measured
    """

    given: TwinFile
    file: TwinFile
    train: tuple[NamedRun, ...]
    runs: RunBatch
    noise_k: float
    rests: Mask
    open_rooms: Mask
    wrong: int

    @property
    def guessed(self) -> bool:
        """True if there is a run whose room nobody measured."""
        return bool(self.open_rooms.any())

    def with_rooms(self, starts: Floats) -> RunBatch:
        """Return the runs with rooms as a fit has them where nobody measured them. starts : [B, S]"""
        if not self.guessed:
            return self.runs
        room = np.where(self.open_rooms[:, None], starts[:, -1:], self.runs.ambient)
        return replace(self.runs, ambient=room)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the training runs."""
        return tuple(named.name for named in self.train)

    @property
    def fit_runs(self) -> FitRuns:
        """The rows that twins are fitted to."""
        power = self.given.nuisance.get("heater_power_run_sd")
        sd = POWER_SD if power is None else max(power, LEAST_SD)
        return FitRuns(self.runs, self.noise_k, self.rests, self.open_rooms, sd)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about the data that were taken out."""
        if not self.wrong:
            return ()
        count = "1 temperature" if self.wrong == 1 else f"{self.wrong} temperatures"
        return (f"{count} of the training runs can't be what the air had and counted as missing",)


def prepare(file: TwinFile, data: DiagnosisRuns, telling: Telling = lambda text: None) -> PreparedRuns:
    """Prepare the training runs. Errors: DataError for a column that the twin needs and the runs have not"""
    work = _with_power(replace(file, sample_s=data.step_s))
    runs = batch_runs([named.run for named in data.train], data.step_s)
    if work.day0_utc is None and "utc" in runs.conditions:
        work = replace(work, day0_utc=float(runs.conditions["utc"].min()))
    wrong = stuck_readings(runs)
    wrong |= spikes(replace(runs, temp=np.where(wrong, np.nan, runs.temp)))
    temp = np.where(wrong, np.nan, runs.temp)
    if (first := wrong_first(temp)).any():
        wrong[first, 0] = True
        temp[first, 0] = np.nan
    runs = replace(runs, temp=temp)
    noise_k = noise_of(file, data)
    resting = np.array([rests(*run, noise_k) for run in zip(runs.temp, runs.duty, strict=True)])
    guessed = np.asarray(np.isnan(runs.ambient).any(axis=1))
    ambient = runs.ambient.copy()
    for i in np.flatnonzero(guessed):
        ambient[i] = usual_room_c(runs.temp[i], bool(resting[i]))
    if not guessed.all():
        ambient[~guessed] = over_rows(ambient[~guessed])
    runs = replace(runs, ambient=ambient)
    wrong_count = int(wrong.sum())
    known = PreparedRuns(file, work, data.train, runs, noise_k, resting, guessed, wrong_count)
    is_open = any(place[1] in (LOSING, STORING) for place in work.to_fit())
    if is_open and runs.duty.any():  # without heat no row says how many watts a loss is
        telling("one mass")
        work = first_twin(work, known.fit_runs)
    return replace(known, file=replace(work, answer_s=_answer_s(work)))


def _answer_s(file: TwinFile) -> float | None:
    """Return the time constant of the air and what is warmed with it; None of a box that loses nothing."""
    twin = file.twin()
    held = float(-twin.system.rates[0, 0])
    return 1.0 / held if held > 0.0 else None


def _with_power(file: TwinFile) -> TwinFile:
    """With the heater's power as known: where it is open, a log tells only ratios to it."""
    place = ("geometry", "heater_max_w")
    power = file.values()[place]
    return file.with_values({place: replace(power, fit=False, rel_sd=None)}) if power.fit else file


def noise_of(file: TwinFile, data: DiagnosisRuns) -> float:
    """Return the noise of a reading, as the twin file declares it or as the rows show it [K]."""
    step_k = file.sensor.get("quantisation_k") or 0.0
    declared = file.sensor.get("noise_sd_k")
    shown = reading_noise_k([named.run for named in data.train])
    return max(float(np.hypot(shown if declared is None else declared, step_k / 12**0.5)), LEAST_K)
