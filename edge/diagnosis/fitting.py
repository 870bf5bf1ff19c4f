"""Maximum likelihood of several twins over the same runs, all fitted side by side.

Each is a twin file whose unknowns move (Levenberg 1944, Marquardt 1963, on whitened innovations, with the
filter of where they start, renewed at the end). What is linear and of no interest of its own, like
a loss that changes a little with T - T_amb, is solved for exactly in every step.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.innovations import FilterGains, whiten
from edge.diagnosis.linearisation import (
    Linearisation,
    TrialState,
    begun_from,
    cost,
    difference,
    explained_cost,
    filters_of,
    neighbours,
    nominal,
    normal_equations,
    prior_cost,
)
from edge.diagnosis.trial import FittedTwin, SizedTerm, Trial, start_of
from edge.diagnosis.unknowns import place_unknowns
from edge.twin.linearise import EnsembleRun, responses
from edge.twin.run_batch import RunBatch

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
CAREFUL, CALMER, BOLDER = 2.0, 8.0, 0.1  # a damping that is tried as well; changes after a step
LARGEST_DAMPING = 1e4  # beyond it there is no way down
LARGEST_MOVE = 1.5  # of a coordinate in one step
LEAST_DAMPING = 1e-6  # share of the normal matrix' diagonal
SETTLED = 0.02  # a gain in nats that is not worth another step


def fit(trials: Sequence[Trial], runs: RunBatch, iterations: int = 6) -> list[FittedTwin]:
    """Each trial at its best, in the order given."""
    if not trials:
        return []
    states = [begun_from(trial) for trial in trials]
    measured = runs.measured
    filters = None
    with np.errstate(over="ignore", invalid="ignore"):  # twins that run away
        for _ in range(iterations):
            moving = [i for i, state in enumerate(states) if not state.done]
            if not moving:
                break
            filters = filters or filters_of(states, runs, measured)
            _improve([states[i] for i in moving], np.array(moving), filters, runs)
        return _finish(states, runs, measured)


def glance(trials: Sequence[Trial], runs: RunBatch) -> list[tuple[Trial, float]]:
    """Each trial one step further, and how likely it is then by the filter of where it began [nats]."""
    states = [begun_from(trial) for trial in trials]
    measured = runs.measured
    filters = filters_of(states, runs, measured)
    _improve(states, np.arange(len(states)), filters, runs)
    spreads = np.where(measured.T[:, None], np.log(filters.sd), 0.0).sum(axis=(0, 2))
    return [
        (
            replace(state.trial, file=place_unknowns(state.trial.file, state.free, state.x), free=state.free),
            float(nats),
        )
        for state, nats in zip(states, -np.array([state.cost for state in states]) - spreads, strict=True)
    ]


def _improve(states: list[TrialState], owners: Indices, filters: FilterGains, runs: RunBatch) -> None:
    """One step of each, the better of a bold and a careful one. owners : their places among the filters"""
    linear = normal_equations(states, owners, filters, runs)
    for state, found in zip(states, linear, strict=True):
        state.cost = cost(found, state)
    tries = [
        [_move(state, found, max(state.damping, least)) for state, found in zip(states, linear, strict=True)]
        for least in (0.0, CAREFUL)
    ]
    costs = np.stack([_costs(tried, states, owners, linear, filters, runs) for tried in tries])
    costs[~np.isfinite(costs)] = np.inf
    for i, state in enumerate(states):
        careful = int(np.argmin(costs[:, i]))
        gained = state.cost - costs[careful, i]
        if not gained > 0.0:
            state.damping = max(state.damping, CAREFUL) * CALMER
            state.done = state.damping > LARGEST_DAMPING or gained > -1e-6
            continue
        state.x, state.cost, state.done = tries[careful][i], float(costs[careful, i]), gained < SETTLED
        state.damping = max(state.damping * (1.0 if careful else BOLDER), LEAST_DAMPING)


def slopes(found: FittedTwin, runs: RunBatch) -> list[SizedTerm]:
    """Return the unknowns of a fitted twin, frozen, as terms that can be fitted with another effect."""
    state = TrialState(found.trial, found.free, found.coordinates)
    twin, steps = nominal(state, state.x, runs)
    wanted = [EnsembleRun(steps, start_of(twin, runs), steps.driven)]
    for other, moved in neighbours(state, runs):
        wanted.append(EnsembleRun(moved, start_of(other, runs), moved.driven))
    shown = responses(wanted)
    return [
        SizedTerm(
            ".".join(item.place),
            ((shown[1 + j] - shown[0]) / difference(item, x)).T,
            item.sd,
            of_reading=True,
            mean=item.mean - x,
        )
        for j, (item, x) in enumerate(zip(found.free, found.coordinates, strict=True))
    ]


def gains_of(trial: Trial, terms: Sequence[SizedTerm], runs: RunBatch) -> Floats:
    """Return the gain in log likelihood of each further term while the
    trial's unknowns stand still [nats].
    """
    state = begun_from(replace(trial, nuisances=(*trial.nuisances, *terms), free=()))
    filters = filters_of([state], runs, runs.measured)
    (found,) = normal_equations([state], np.array([0]), filters, runs)
    own = len(trial.nuisances)
    normal, gradient = found.normal, found.gradient
    known = np.linalg.solve(normal[:own, :own], np.column_stack([normal[:own, own:], gradient[:own]]))
    left = gradient[own:] - normal[own:, :own] @ known[:, -1]
    size = np.diag(normal)[own:] - np.einsum("ti,it->t", normal[own:, :own], known[:, :-1])
    return np.asarray(0.5 * left**2 / size)


def _move(state: TrialState, found: Linearisation, damping: float) -> Floats:
    """Return the unknowns after a damped step, inside their bounds. Nuisances follow by themselves."""
    p = len(state.free)
    normal = found.normal + damping * np.diag(np.diag(found.normal))
    move = np.linalg.lstsq(normal, found.gradient, rcond=1e-12)[0][:p]
    largest = np.abs(move).max(initial=0.0)
    if largest > LARGEST_MOVE:
        move *= LARGEST_MOVE / largest
    limits = np.array([item.bounds for item in state.free]).reshape(-1, 2)
    return np.clip(state.x + move, limits[:, 0], limits[:, 1])


def _costs(
    tried: list[Floats],
    states: list[TrialState],
    owners: Indices,
    linear: list[Linearisation],
    filters: FilterGains,
    runs: RunBatch,
) -> Floats:
    """Return the cost of each state's next place, with the terms linearised at its present place."""
    wanted = []
    for state, x in zip(states, tried, strict=True):
        twin, steps = nominal(state, x, runs)
        wanted.append(EnsembleRun(steps, start_of(twin, runs), steps.driven))
    white = whiten(filters, owners, np.nan_to_num(runs.temp[:, 1:]) - responses(wanted))
    costs = np.empty(len(tried))
    for j, (state, x, found) in enumerate(zip(states, tried, linear, strict=True)):
        residual, p = white[j].ravel(), len(state.free)
        means = np.array([term.mean / term.sd**2 for term in state.trial.nuisances])
        moved = replace(found, gradient=np.concatenate([found.gradient[:p], found.terms @ residual + means]))
        costs[j] = 0.5 * (float(residual @ residual) + prior_cost(state, x)) - explained_cost(moved, p)
    return costs


def _finish(states: list[TrialState], runs: RunBatch, measured: NDArray[np.bool_]) -> list[FittedTwin]:
    filters = filters_of(states, runs, measured)
    linear = normal_equations(states, np.arange(len(states)), filters, runs)
    found = []
    for i, (state, own) in enumerate(zip(states, linear, strict=True)):
        spreads = np.log(filters.sd[:, i].T)[measured].sum()
        p = len(state.free)
        inverse = np.asarray(np.linalg.pinv(own.normal, hermitian=True), dtype=np.float64)
        sizes = np.asarray(np.linalg.solve(own.normal[p:, p:], own.gradient[p:]))
        nats = -cost(own, state) - float(spreads)
        found.append(
            FittedTwin(
                state.trial,
                place_unknowns(state.trial.file, state.free, state.x),
                state.free,
                state.x,
                nats if np.isfinite(nats) else -np.inf,
                inverse,
                np.asarray((own.residual - sizes @ own.terms).reshape(measured.shape)),
                sizes,
                np.asarray(np.sqrt(np.diag(inverse)[p:])),
            )
        )
    return found
