"""Which signals the unexplained heat depends on: those without which no small formula explains it as well.

Regressed are the innovations of the filter that tracks the heat, on what each term's heat would do to them:
whitened by the same filter, so that slow wandering counts for little and rows are independent, and with
regressors from rows before only, so that noise in a reading does not look like a dependence.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.residuals import Residuals
from edge.diagnosis.locate.subsets import SumRegression
from edge.diagnosis.locate.terms import FormulaTerm, library
from edge.diagnosis.locate.whitening import response_to

Floats = NDArray[np.float64]
FALSE_ALARM = 0.01  # chance of any dependence where there is none
FEWEST_ROWS = 30
FEWEST_PARTS = 8  # that the runs are cut into: a dependence must hold in most of them
CLEAR = 2.5  # standard errors, over those parts
POWER_RUN_SD_W = 1.5  # of a 100 W heater


@dataclass(frozen=True, slots=True)
class Dependence:
    """A signal on which the heat depends.

    strength : share of what the best formula explains that is lost without the signal, 0..1
    p_value : chance that a signal without influence would seem to matter as much, all that were tried counted
    """

    name: str
    strength: float
    p_value: float


@dataclass(frozen=True, slots=True)
class Explanation:
    """The best small formula, as a description and not as physics.

    terms, coefficients_w : formulas and what each is to be multiplied by [W]
    share : of the white innovations' square that it explains
    """

    terms: tuple[str, ...]
    coefficients_w: tuple[float, ...]
    share: float
    depends: tuple[Dependence, ...]


NOTHING = Explanation((), (), 0.0, ())


def depends_on(runs: Sequence[Residuals], power_run_sd_w: float = POWER_RUN_SD_W) -> list[Dependence]:
    """Signals that matter, the strongest first; [] where none does for sure.

    power_run_sd_w : sd of the full heater's power from run to run, which is no dependence [W]
    """
    return list(explain(runs, power_run_sd_w).depends)


def explain(runs: Sequence[Residuals], power_run_sd_w: float = POWER_RUN_SD_W) -> Explanation:
    """Fit the best small formula for the unexplained heat; return it and the signals that it needs."""
    told = sum(int((run.white != 0.0).sum()) for run in runs)
    if told < FEWEST_ROWS:
        return NOTHING
    terms, columns, innovations, sizes = _regressors(runs, power_run_sd_w)
    regression = SumRegression.of(columns, innovations, told)
    chosen = _holding(runs, columns, innovations, regression.best(range(len(terms))))
    if not chosen:
        return NOTHING
    left = regression.remainder(chosen)
    found = []
    for name in {name: None for i in chosen for name in terms[i].signals}:
        # What the best formula without this signal loses: a signal that another can stand for is not needed.
        others = regression.best([i for i in range(len(terms)) if name not in terms[i].signals])
        lost = regression.remainder(others) - left
        chance = _chance(lost, left, told - len(chosen), len(terms))
        if chance < FALSE_ALARM:
            strength = min(max(lost / (regression.total - left), 0.0), 1.0)
            found.append(Dependence(name, float(strength), chance))
    sizes_w = np.linalg.lstsq(columns[:, chosen], innovations, rcond=None)[0] / sizes[list(chosen)]
    return Explanation(
        tuple(terms[i].formula for i in chosen),
        tuple(float(value) for value in sizes_w),
        1.0 - left / regression.total,
        tuple(sorted(found, key=lambda item: -item.strength)),
    )


def _regressors(
    runs: Sequence[Residuals], power_run_sd_w: float
) -> tuple[list[FormulaTerm], Floats, Floats, Floats]:
    """Terms that vary; what they do to the innovations, [R, p], of length 1; the innovations; the lengths.

    Of both what a constant heat would explain is taken out: it depends on nothing.
    """
    terms, parts = library(runs), []
    for run in runs:
        every = [np.nan_to_num(term.value(run)) for term in terms]
        caused = response_to(run.response, np.stack([*every, np.ones_like(run.duty), run.duty], axis=1))
        seen = np.column_stack([caused[:, :-1], run.white])
        parts.append(_without_own_size(seen, power_run_sd_w * caused[:, -1]))
    table = np.concatenate(parts)
    constant, seen = table[:, -2:-1], np.delete(table, -2, axis=1)
    rest = seen - constant @ np.linalg.lstsq(constant, seen, rcond=None)[0]
    columns, sizes = rest[:, :-1], np.linalg.norm(rest[:, :-1], axis=0)
    varies = sizes > 1e-6 * np.maximum(np.linalg.norm(seen[:, :-1], axis=0), 1e-300)
    kept = [term for term, vary in zip(terms, varies, strict=True) if vary]
    return kept, columns[:, varies] / sizes[varies], rest[:, -1], sizes[varies]


def _without_own_size(columns: Floats, own: Floats) -> Floats:
    """Return a run's columns whitened for a size that differs between runs: times (1 + own own')^-1/2."""
    square = float(own @ own)
    if not square > 0.0:
        return columns
    shrink = (1.0 - 1.0 / np.sqrt(1.0 + square)) / square
    return np.asarray(columns - shrink * np.outer(own, own @ columns))


def _holding(
    runs: Sequence[Residuals], columns: Floats, innovations: Floats, chosen: tuple[int, ...]
) -> tuple[int, ...]:
    """Return the terms without which left-out parts of the runs are forecast clearly worse."""
    pieces = max(1, -(-FEWEST_PARTS // len(runs)))
    lengths = [len(part) for run in runs for part in np.array_split(run.white, pieces)]
    part = np.repeat(np.arange(len(lengths)), lengths)
    while chosen:
        whole = _left_out(columns[:, chosen], innovations, part)
        gains = []
        for i in chosen:
            others = [j for j in chosen if j != i]
            gains.append(_clear(_left_out(columns[:, others], innovations, part) - whole))
        weakest = int(np.argmin(gains))
        if gains[weakest] > CLEAR:
            break
        chosen = chosen[:weakest] + chosen[weakest + 1 :]
    return chosen


def _left_out(columns: Floats, innovations: Floats, part: NDArray[np.intp]) -> Floats:
    """Squared error of each part, by a fit on the others."""
    count = int(part.max()) + 1
    found = np.empty(count)
    for i in range(count):
        here = part == i
        sizes = np.linalg.lstsq(columns[~here], innovations[~here], rcond=None)[0]
        found[i] = ((innovations[here] - columns[here] @ sizes) ** 2).sum()
    return found


def _clear(gains: Floats) -> float:
    """How many standard errors the mean is above 0."""
    return float(gains.mean() / max(gains.std(ddof=1) / np.sqrt(len(gains)), 1e-300))


def _chance(lost: float, left: float, freedom: int, tried: int) -> float:
    from scipy.special import fdtrc  # the tail of F; scipy.stats takes a second to load

    return float(min(1.0, tried * fdtrc(1, freedom, max(lost, 0.0) * freedom / left)))
