"""Maximum likelihood of several twins over the same runs, all fitted side by side.

Each is a twin file whose unknowns move (Levenberg 1944, Marquardt 1963, on whitened innovations, with the
filter's gains held over a step and renewed between steps). What is linear and of no interest of its own, like
a loss that changes a little with T - T_amb, is solved for exactly in every step.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.twin.diagnosis.innovations import Filtered, Gains, NoiseLevels, gains, whitened
from edge.twin.diagnosis.unknowns import Unknown, path_priors, placed, unknowns
from edge.twin.ensemble import Response, responses
from edge.twin.linear_steps import LinearSteps, linear_steps
from edge.twin.model import Twin
from edge.twin.recorded import Recorded
from edge.twin.twin_file import TwinFile
from edge.twin.warm_start import at_rest, spread

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
DIFFERENCE = 1e-2  # of a coordinate, for a derivative
DAMPINGS = (0.0, 0.1, 10.0)  # tried side by side, shares of the normal matrix' diagonal
LARGEST_MOVE = 1.5  # of a coordinate in one step
SETTLED = 0.02  # a gain in nats that is not worth another step


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """Something of unknown size that acts in proportion to it: heat into the air, or an error of the reading.

    shape : [N, B] for a size of 1, W or K; sd : of the size, before the runs are seen
    """

    name: str
    shape: Floats
    sd: float
    of_reading: bool = False

    def response(self, steps: LinearSteps) -> Response:
        """What it does to the temperature, where that goes through the twin."""
        driven = None if self.of_reading else steps.heat * self.shape[..., None]
        return Response(steps, None, driven)


@dataclass(frozen=True, slots=True)
class Trial:
    """A twin to be fitted: its file, its noise, and terms whose sizes are found with it."""

    file: TwinFile
    levels: NoiseLevels
    nuisances: tuple[Term, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A trial at its best.

    file : with the values found; free : what moved
    log_likelihood : in nats, priors included, up to a constant of the data
    covariance : [p, p], of the coordinates; innovations : [B, N] in standard deviations, 0 where not measured
    sizes : of the nuisances
    """

    trial: Trial
    file: TwinFile
    free: tuple[Unknown, ...]
    coordinates: Floats
    log_likelihood: float
    covariance: Floats
    innovations: Floats
    sizes: Floats


@dataclass(slots=True, eq=False)
class _State:
    """A trial on its way."""

    trial: Trial
    free: tuple[Unknown, ...]
    x: Floats
    cost: float = np.inf
    damping: float = 1.0
    done: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """Sums over all rows: normal matrix and gradient, over the unknowns and then the nuisances."""

    normal: Floats
    gradient: Floats
    square: float
    residual: Floats


def start_of(twin: Twin, runs: Recorded) -> Floats:
    """Where runs begin, [B, n]: at rest with the first temperature."""
    first = zip(runs.temp[:, 0], runs.ambient[:, 0], strict=True)
    return np.stack([at_rest(twin, float(temp), float(room)) for temp, room in first])


def fit(trials: Sequence[Trial], runs: Recorded, iterations: int = 6) -> list[Fitted]:
    """Each trial at its best, in the order given."""
    states = [_begun(trial) for trial in trials]
    measured = np.isfinite(runs.temp[:, 1:])
    for _ in range(iterations):
        moving = [state for state in states if not state.done]
        if not moving:
            break
        _improve(moving, runs, measured)
    return _finished(states, runs, measured)


def _begun(trial: Trial) -> _State:
    free = unknowns(trial.file)
    values = trial.file.values()
    x = np.array([item.coordinate(values[item.place].value) for item in free])
    return _State(trial, free, x)


def _improve(states: list[_State], runs: Recorded, measured: NDArray[np.bool_]) -> None:
    """One step of each."""
    linear, filters = _linearise(states, runs, measured)
    tried = []
    for state, found in zip(states, linear, strict=True):
        state.cost = _cost(found, state)
        tried += [_moved(state, found, state.damping * share) for share in DAMPINGS]
    costs = _costs(tried, states, filters, runs, measured)
    for i, state in enumerate(states):
        own = costs[i * len(DAMPINGS) : (i + 1) * len(DAMPINGS)]
        best = int(np.nanargmin(own)) if np.isfinite(own).any() else 0
        gained = state.cost - own[best]
        if not gained > 0.0:
            state.damping *= 100.0
            state.done = state.damping > 1e5
            continue
        state.x = tried[i * len(DAMPINGS) + best]
        state.damping = max(state.damping * max(DAMPINGS[best], 1e-2), 1e-6) if best != 1 else state.damping
        state.done = gained < SETTLED


def _linearise(
    states: list[_State], runs: Recorded, measured: NDArray[np.bool_]
) -> tuple[list[_Linearised], Gains]:
    """Residuals and their derivatives, whitened."""
    wanted: list[Response] = []
    filtered: list[Filtered] = []
    owner: list[int] = []
    for i, state in enumerate(states):
        twin, steps = _nominal(state, state.x, runs)
        filtered.append(Filtered(steps, state.trial.levels, spread(twin), twin.step_s))
        wanted.append(Response(steps, start_of(twin, runs), steps.driven))
        for j, item in enumerate(state.free):
            near = state.x.copy()
            near[j] += _difference(item, near[j])
            other, moved = _nominal(state, near, runs)
            wanted.append(Response(moved, start_of(other, runs), moved.driven))
        wanted += [term.response(steps) for term in state.trial.nuisances]
        owner += [i] * (1 + len(state.free) + len(state.trial.nuisances))
    filters = gains(filtered, measured)
    columns = _columns(responses(wanted), states, runs)
    white = whitened(filters, np.array(owner), columns)
    found, place = [], 0
    for state in states:
        count = len(state.free) + len(state.trial.nuisances)
        own = white[place : place + 1 + count].reshape(1 + count, -1)
        found.append(_normal(own, state))
        place += 1 + count
    return found, filters


def _nominal(state: _State, x: Floats, runs: Recorded) -> tuple[Twin, LinearSteps]:
    twin = placed(state.trial.file, state.free, x).twin()
    return twin, linear_steps(twin, runs)


def _difference(item: Unknown, x: float) -> float:
    """Towards the inside."""
    return DIFFERENCE if x + DIFFERENCE <= item.bounds[1] else -DIFFERENCE


def _columns(shown: Floats, states: list[_State], runs: Recorded) -> Floats:
    """From temperatures to the residual, its derivatives by the unknowns and the nuisances."""
    place = 0
    measured = np.nan_to_num(runs.temp[:, 1:])
    for state in states:
        nominal = shown[place].copy()
        for j, item in enumerate(state.free):
            shown[place + 1 + j] = (shown[place + 1 + j] - nominal) / _difference(item, state.x[j])
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


def _normal(columns: Floats, state: _State) -> _Linearised:
    """With the priors of the unknowns, of what two values must agree on, and of the nuisances."""
    residual, slopes = columns[0], columns[1:]
    normal, gradient = slopes @ slopes.T, slopes @ residual
    p = len(state.free)
    for j, item in enumerate(state.free):
        normal[j, j] += item.sd**-2
        gradient[j] += (item.mean - state.x[j]) / item.sd**2
    for j, term in enumerate(state.trial.nuisances):
        normal[p + j, p + j] += term.sd**-2
    normal[:p, :p], gradient[:p] = _with_paths(normal[:p, :p], gradient[:p], state)
    return _Linearised(normal, gradient, float(residual @ residual), residual)


def _with_paths(normal: Floats, gradient: Floats, state: _State) -> tuple[Floats, Floats]:
    here = path_priors(placed(state.trial.file, state.free, state.x))
    if not here:
        return normal, gradient
    slopes = np.empty((len(here), len(state.free)))
    for j, item in enumerate(state.free):
        near = state.x.copy()
        near[j] += _difference(item, near[j])
        there = path_priors(placed(state.trial.file, state.free, near))
        slopes[:, j] = (np.array(there) - here) / _difference(item, state.x[j])
    return normal + slopes.T @ slopes, gradient - slopes.T @ np.array(here)


def _penalty(state: _State, x: Floats) -> float:
    own = sum(((a - item.mean) / item.sd) ** 2 for a, item in zip(x, state.free, strict=True))
    paths = path_priors(placed(state.trial.file, state.free, x))
    return float(own + sum(item**2 for item in paths))


def _cost(found: _Linearised, state: _State) -> float:
    """Half the sum of squares, the nuisances at their best."""
    return 0.5 * (found.square + _penalty(state, state.x)) - _explained(found, len(state.free))


def _explained(found: _Linearised, p: int) -> float:
    if p == len(found.gradient):
        return 0.0
    gradient = found.gradient[p:]
    return 0.5 * float(gradient @ np.linalg.solve(found.normal[p:, p:], gradient))


def _moved(state: _State, found: _Linearised, damping: float) -> Floats:
    """The unknowns after a damped step, inside their bounds; nuisances follow on their own."""
    p = len(state.free)
    normal = found.normal + damping * np.diag(np.diag(found.normal))
    move = np.linalg.lstsq(normal, found.gradient, rcond=1e-12)[0][:p]
    largest = np.abs(move).max(initial=0.0)
    if largest > LARGEST_MOVE:
        move *= LARGEST_MOVE / largest
    limits = np.array([item.bounds for item in state.free]).reshape(-1, 2)
    return np.clip(state.x + move, limits[:, 0], limits[:, 1])


def _costs(
    tried: list[Floats], states: list[_State], filters: Gains, runs: Recorded, measured: NDArray[np.bool_]
) -> Floats:
    """What each step of each state would cost, by the gains from where it stands."""
    wanted, owner = [], []
    for i, x in enumerate(tried):
        state = states[i // len(DAMPINGS)]
        twin, steps = _nominal(state, x, runs)
        wanted.append(Response(steps, start_of(twin, runs), steps.driven))
        wanted += [term.response(steps) for term in state.trial.nuisances]
        owner += [i // len(DAMPINGS)] * (1 + len(state.trial.nuisances))
    shown = responses(wanted)
    costs, place = np.empty(len(tried)), 0
    counts = [1 + len(states[i // len(DAMPINGS)].trial.nuisances) for i in range(len(tried))]
    for i in range(len(tried)):
        shown[place] = np.nan_to_num(runs.temp[:, 1:]) - shown[place]
        place = _readings(shown, place + 1, states[i // len(DAMPINGS)].trial)
    white = whitened(filters, np.array(owner), shown)
    place = 0
    for i, x in enumerate(tried):
        state = states[i // len(DAMPINGS)]
        own = white[place : place + counts[i]].reshape(counts[i], -1)
        place += counts[i]
        cost = 0.5 * (float(own[0] @ own[0]) + _penalty(state, x))
        if counts[i] > 1:
            normal = own[1:] @ own[1:].T + np.diag([term.sd**-2 for term in state.trial.nuisances])
            gradient = own[1:] @ own[0]
            cost -= 0.5 * float(gradient @ np.linalg.solve(normal, gradient))
        costs[i] = cost
    return costs


def _finished(states: list[_State], runs: Recorded, measured: NDArray[np.bool_]) -> list[Fitted]:
    linear, filters = _linearise(states, runs, measured)
    found = []
    for i, (state, own) in enumerate(zip(states, linear, strict=True)):
        spreads = np.log(filters.sd[:, i].T)[measured].sum()
        p = len(state.free)
        inverse = np.linalg.pinv(own.normal, hermitian=True)
        sizes = np.linalg.solve(own.normal[p:, p:], own.gradient[p:]) if p < len(own.gradient) else np.zeros(0)
        found.append(
            Fitted(
                state.trial,
                placed(state.trial.file, state.free, state.x),
                state.free,
                state.x,
                -_cost(own, state) - float(spreads),
                inverse[:p, :p],
                own.residual.reshape(measured.shape),
                sizes,
            )
        )
    return found


def with_levels(trial: Trial, **changed: float) -> Trial:
    """The trial with other noise."""
    return replace(trial, levels=replace(trial.levels, **changed))
