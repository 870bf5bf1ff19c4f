"""Trials on their way: where they stand, and the sums over all rows that tell the next step.

All are run and whitened side by side, each with its derivatives by its unknowns and by its terms.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.innovations import FilterGains, FilterInput, gains, whiten
from edge.diagnosis.trial import Trial, start_of, start_spread
from edge.diagnosis.unknowns import UnknownValue, path_priors, place_unknowns, unknowns
from edge.twin.linearise import EnsembleRun, LinearSteps, linearise, responses
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
DIFFERENCE = 1e-2  # of a coordinate, for a derivative
FIRST_DAMPING = 1e-3  # share of the normal matrix' diagonal
RUNAWAY = 1e12  # standard deviations, of an error or of its derivative
REMEMBERED = 3  # places of a fit: where it stands and the two that it tries


@dataclass(slots=True, eq=False)
class TrialState:
    """A trial on its way."""

    trial: Trial
    free: tuple[UnknownValue, ...]
    x: Floats
    cost: float = np.inf
    damping: float = FIRST_DAMPING
    done: bool = False
    seen: dict[bytes, tuple[BoxTwin, LinearSteps]] = field(default_factory=dict)  # the last places


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """Sums over all rows: normal matrix and gradient, over the unknowns and then the nuisances."""

    normal: Floats
    gradient: Floats
    square: float
    residual: Floats
    terms: Floats  # whitened, [terms, B N]


def filters_of(states: list[TrialState], runs: RunBatch, measured: NDArray[np.bool_]) -> FilterGains:
    """Return the filter gains of the present states."""
    filtered = []
    for state in states:
        twin, steps = nominal(state, state.x, runs)
        filtered.append(FilterInput(steps, state.trial.levels, start_spread(twin, runs), twin.step_s))
    return gains(filtered, measured)


def begun_from(trial: Trial) -> TrialState:
    """Return the state that a trial's file begins with."""
    free = unknowns(trial.file) if trial.free is None else trial.free
    values = trial.file.values()
    x = np.array([item.coordinate(values[item.place].value) for item in free])
    return TrialState(trial, free, x)


def neighbours(state: TrialState, runs: RunBatch) -> list[tuple[BoxTwin, LinearSteps]]:
    """Return the twin displaced a little in each unknown."""
    found = []
    for j, item in enumerate(state.free):
        near = state.x.copy()
        near[j] += difference(item, near[j])
        found.append(_at(state, near, runs))
    return found


def normal_equations(
    states: list[TrialState], owners: Indices, filters: FilterGains, runs: RunBatch
) -> list[Linearisation]:
    """Residuals and their derivatives, whitened."""
    wanted: list[EnsembleRun] = []
    counts = [1 + len(state.free) + len(state.trial.nuisances) for state in states]
    for state in states:
        twin, steps = nominal(state, state.x, runs)
        wanted.append(EnsembleRun(steps, start_of(twin, runs), steps.driven))
        for other, moved in neighbours(state, runs):
            wanted.append(EnsembleRun(moved, start_of(other, runs), moved.driven))
        wanted += [term.response(steps) for term in state.trial.nuisances]
    columns = _columns(responses(wanted), states, runs)
    white = whiten(filters, np.repeat(owners, counts), columns)
    parts = np.split(white.reshape(len(white), -1), np.cumsum(counts)[:-1])
    return [_normal(own, state) for own, state in zip(parts, states, strict=True)]


def nominal(state: TrialState, x: Floats, runs: RunBatch) -> tuple[BoxTwin, LinearSteps]:
    """Return the twin at `x`; each step begins where the last one ended."""
    place = x.tobytes()
    if place not in state.seen:
        while len(state.seen) >= REMEMBERED:
            del state.seen[next(iter(state.seen))]
        state.seen[place] = _at(state, x, runs)
    return state.seen[place]


def _at(state: TrialState, x: Floats, runs: RunBatch) -> tuple[BoxTwin, LinearSteps]:
    twin = place_unknowns(state.trial.file, state.free, x).twin()
    return twin, linearise(twin, runs)


def difference(item: UnknownValue, x: float) -> float:
    """Return the difference of a coordinate for a derivative, towards the inside of its bounds."""
    return DIFFERENCE if x + DIFFERENCE <= item.bounds[1] else -DIFFERENCE


def _columns(shown: Floats, states: list[TrialState], runs: RunBatch) -> Floats:
    """From temperatures to the residual, its derivatives by the unknowns and the nuisances."""
    place = 0
    measured = np.nan_to_num(runs.temp[:, 1:])
    for state in states:
        nominal = shown[place].copy()
        for j, item in enumerate(state.free):
            shown[place + 1 + j] = (shown[place + 1 + j] - nominal) / difference(item, state.x[j])
        shown[place] = measured - nominal
        place += 1 + len(state.free)
        place = _readings(shown, place, state.trial)
    return shown


def _readings(shown: Floats, place: int, trial: Trial) -> int:
    """Put in what goes past the twin; returns the place behind the trial's terms."""
    for i, term in enumerate(trial.nuisances):
        if term.of_reading:
            shown[place + i] = term.shape.T
    return place + len(trial.nuisances)


def _normal(columns: Floats, state: TrialState) -> Linearisation:
    """With the priors of the unknowns, of what two values must agree on, and of the nuisances."""
    residual, slopes = columns[0], columns[1:]
    p = len(state.free)
    if not np.abs(columns).max(initial=0.0) < RUNAWAY:
        # A twin that runs away is infinitely bad, and no way leads on from it.
        own = np.zeros_like(columns)
        return Linearisation(np.eye(len(slopes)), np.zeros(len(slopes)), np.inf, own[0], own[1 + p :])
    normal, gradient = slopes @ slopes.T, slopes @ residual
    for j, item in enumerate(state.free):
        normal[j, j] += item.sd**-2
        gradient[j] += (item.mean - state.x[j]) / item.sd**2
    for j, term in enumerate(state.trial.nuisances):
        normal[p + j, p + j] += term.sd**-2
        gradient[p + j] += term.mean / term.sd**2
    normal[:p, :p], gradient[:p] = _with_paths(normal[:p, :p], gradient[:p], state)
    return Linearisation(normal, gradient, float(residual @ residual), residual, slopes[p:])


def _with_paths(normal: Floats, gradient: Floats, state: TrialState) -> tuple[Floats, Floats]:
    here = path_priors(place_unknowns(state.trial.file, state.free, state.x))
    if not here:
        return normal, gradient
    slopes = np.empty((len(here), len(state.free)))
    for j, item in enumerate(state.free):
        near = state.x.copy()
        near[j] += difference(item, near[j])
        there = path_priors(place_unknowns(state.trial.file, state.free, near))
        slopes[:, j] = (np.array(there) - here) / difference(item, state.x[j])
    return normal + slopes.T @ slopes, gradient - slopes.T @ np.array(here)


def prior_cost(state: TrialState, x: Floats) -> float:
    """Squares by which the unknowns, and what two of them must agree on, are off their priors."""
    own = sum(((a - item.mean) / item.sd) ** 2 for a, item in zip(x, state.free, strict=True))
    paths = path_priors(place_unknowns(state.trial.file, state.free, x))
    return float(own + sum(item**2 for item in paths))


def cost(found: Linearisation, state: TrialState) -> float:
    """Half the sum of squares, the nuisances at their best."""
    return 0.5 * (found.square + prior_cost(state, state.x)) - explained_cost(found, len(state.free))


def explained_cost(found: Linearisation, p: int) -> float:
    """Cost that the nuisances take away at their best; p : how many unknowns come before them."""
    if p == len(found.gradient):
        return 0.0
    gradient = found.gradient[p:]
    return 0.5 * float(gradient @ np.linalg.solve(found.normal[p:, p:], gradient))
