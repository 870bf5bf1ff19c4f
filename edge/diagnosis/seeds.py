"""Starts of fits: one mass from several time constants, and what most boxes have, grown on thin rows.

A fit's end depends on its start where rates are unknown by factors of a hundred. Thin rows tell those well
enough, at little cost.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.baselines import LOSING, STORING
from edge.diagnosis.twin_choice import FINELY, Names, TwinChoice, candidates_of, is_slow
from edge.diagnosis.twin_fit import FitRuns, FittedTwin, begun, fit_twins
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import Place, TwinFile

Floats = NDArray[np.float64]
ROWS = 400  # that are fitted to: thinner rows cost accuracy, more of them time
ANSWERS = (1.0, 4.0, 15.0, 60.0)  # time constants that the longest run may last
MOST = 4  # sets to begin with


def first_twin(file: TwinFile, runs: FitRuns) -> TwinFile:
    """Return a file with its open values where they fit best, of several starts."""
    if not file.to_fit():
        return file
    rows, thin = _thin(runs)
    coarse = replace(file, sample_s=file.sample_s * thin)
    starts = [begun(each) for each in _starts(coarse, rows)]
    best = min(fit_twins(starts, rows, FINELY), key=lambda fit: fit.rmse_k)
    values, found = file.values(), best.file.values()
    return file.with_values(
        {place: replace(values[place], value=found[place].value) for place in file.to_fit()}
    )


def seeds(file: TwinFile, runs: FitRuns) -> dict[Names, FittedTwin]:
    """Return sets of lags and bodies as thin rows have them, likeliest first."""
    rows, thin = _thin(runs)
    if thin == 1:
        return {}
    coarse = replace(file, sample_s=file.sample_s * thin)
    choice = TwinChoice(coarse, rows, [name for name in candidates_of(coarse, rows) if is_slow(name)])
    choice.grow()
    best = sorted(filter(None, choice.tried), key=lambda names: choice.tried[names].left_out_k)[:MOST]
    return {names: choice.tried[names].fit for names in best}


def _starts(file: TwinFile, runs: FitRuns) -> Iterator[TwinFile]:
    """Yield the file with loss and capacity, as far as they are open, for each time constant."""
    yield file
    twin, batch = file.twin(), runs.batch
    air_j_k, power_w = twin.geometry.air_capacity_j_k, twin.geometry.heater_max_w
    rows = int(runs.seen.sum(axis=1).max())
    values = file.values()
    for times in ANSWERS:
        left = float(np.exp(-times / rows))
        warm = np.zeros(len(batch.duty))
        level = [warm := left * warm + column * file.sample_s for column in batch.duty.T]
        swing = float(np.ptp(level)) * power_w
        capacity_j_k = swing / max(float(np.nanmax(batch.temp) - np.nanmin(batch.temp)), runs.noise_k)
        loss_w_k = capacity_j_k * times / (rows * file.sample_s)
        guesses = {STORING: capacity_j_k / air_j_k, LOSING: loss_w_k}
        places = [place for place in file.to_fit() if place[1] in guesses]
        yield file.with_values(
            {place: replace(values[place], value=_inside(file, place, guesses[place[1]])) for place in places}
        )


def _inside(file: TwinFile, place: Place, value: float) -> float:
    possible = file.possible(place)
    return min(max(value, possible.low), possible.high)


def _thin(runs: FitRuns) -> tuple[FitRuns, int]:
    """Return every so many rows, inputs as their means, and how many are one."""
    thin = max(1, int(np.ceil(runs.seen.sum() / ROWS)))
    thin = min(thin, max(1, runs.seen.shape[1] // 20))
    if thin == 1:
        return runs, 1
    batch = runs.batch
    rows = batch.duty.shape[1] // thin * thin

    def mean(column: Floats) -> Floats:
        return np.asarray(column[:, :rows].reshape(len(column), -1, thin).mean(axis=2))

    conditions = {name: mean(column) for name, column in batch.conditions.items()}
    temp = batch.temp[:, : rows + 1 : thin]
    few = RunBatch(temp, mean(batch.duty), mean(batch.fan), mean(batch.ambient), conditions)
    return replace(runs, batch=few), thin
