"""Maximum likelihood of several twins over the same runs, all fitted side by side.

Each is a twin file whose unknowns move (Levenberg 1944, Marquardt 1963, on whitened innovations, with the
filter of where they start, renewed at the end). What is linear and of no interest of its own, like
a loss that changes a little with T - T_amb, is solved for exactly in every step.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

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
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-6  # share of the normal matrix' diagonal
CAREFUL, CALMER, BOLDER = 2.0, 8.0, 0.1  # a damping that is tried as well; changes after a step
LARGEST_DAMPING = 1e4  # beyond it there is no way down
LARGEST_MOVE = 1.5  # of a coordinate in one step
REMEMBERED = 3  # places of a fit: where it stands and the two that it tries
SETTLED = 0.02  # a gain in nats that is not worth another step


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """Something of unknown size that acts in proportion to it: heat into the air, or an error of a reading.

    shape : [N, B] for a size of 1, W or K; of_reading, of_room : of the air's or the room's temperature;
    mean, sd : of the size, before the runs are seen
    """

    name: str
    shape: Floats
    sd: float
    of_reading: bool = False
    mean: float = 0.0
    of_room: bool = False

    def response(self, steps: LinearSteps) -> Response:
        """What it does to the temperature, where that goes through the twin."""
        if self.of_reading:
            return Response(steps, None, None)
        gain = steps.room if self.of_room else steps.heat
        return Response(steps, None, gain * self.shape[..., None])


@dataclass(frozen=True, slots=True)
class Trial:
    """A twin to be fitted: its file, its noise, and terms whose sizes are found with it.

    free : what may move, with its priors; None: what the file says of its values
    """

    file: TwinFile
    levels: NoiseLevels
    nuisances: tuple[Term, ...] = ()
    free: tuple[Unknown, ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A trial at its best.

    file : with the values found; free : what moved
    log_likelihood : in nats, priors included, up to a constant of the data
    covariance : [p + q, p + q], of the coordinates and then the sizes of the q nuisances
    innovations : [B, N] in standard deviations, 0 where not measured
    sizes, size_sds : of the nuisances
    """

    trial: Trial
    file: TwinFile
    free: tuple[Unknown, ...]
    coordinates: Floats
    log_likelihood: float
    covariance: Floats
    innovations: Floats
    sizes: Floats
    size_sds: Floats


@dataclass(slots=True, eq=False)
class _State:
    """A trial on its way."""

    trial: Trial
    free: tuple[Unknown, ...]
    x: Floats
    cost: float = np.inf
    damping: float = FIRST_DAMPING
    done: bool = False
    seen: dict[bytes, tuple[Twin, LinearSteps]] = field(default_factory=dict)  # the last places


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """Sums over all rows: normal matrix and gradient, over the unknowns and then the nuisances."""

    normal: Floats
    gradient: Floats
    square: float
    residual: Floats
    terms: Floats  # whitened, [terms, B N]


def start_of(twin: Twin, runs: Recorded) -> Floats:
    """Where runs begin, [B, n]: at rest with the first temperature."""
    return at_rest(twin, runs.temp[:, 0], runs.ambient[:, 0])


def fit(trials: Sequence[Trial], runs: Recorded, iterations: int = 6) -> list[Fitted]:
    """Each trial at its best, in the order given."""
    states = [_begun(trial) for trial in trials]
    measured = np.isfinite(runs.temp[:, 1:])
    filters = None
    for _ in range(iterations):
        moving = [i for i, state in enumerate(states) if not state.done]
        if not moving:
            break
        filters = filters or _filters(states, runs, measured)
        _improve([states[i] for i in moving], np.array(moving), filters, runs)
    return _finished(states, runs, measured)


def glance(trials: Sequence[Trial], runs: Recorded) -> list[tuple[Trial, float]]:
    """Each trial one step further, and how likely it is then by the filter of where it began [nats]."""
    states = [_begun(trial) for trial in trials]
    measured = np.isfinite(runs.temp[:, 1:])
    filters = _filters(states, runs, measured)
    _improve(states, np.arange(len(states)), filters, runs)
    spreads = np.where(measured.T[:, None], np.log(filters.sd), 0.0).sum(axis=(0, 2))
    return [
        (
            replace(state.trial, file=placed(state.trial.file, state.free, state.x), free=state.free),
            float(nats),
        )
        for state, nats in zip(states, -np.array([state.cost for state in states]) - spreads, strict=True)
    ]


def _filters(states: list[_State], runs: Recorded, measured: NDArray[np.bool_]) -> Gains:
    """Of the states as they stand."""
    filtered = []
    for state in states:
        twin, steps = _nominal(state, state.x, runs)
        filtered.append(Filtered(steps, state.trial.levels, spread(twin), twin.step_s))
    return gains(filtered, measured)


def _begun(trial: Trial) -> _State:
    free = unknowns(trial.file) if trial.free is None else trial.free
    values = trial.file.values()
    x = np.array([item.coordinate(values[item.place].value) for item in free])
    return _State(trial, free, x)


def _improve(states: list[_State], owners: Indices, filters: Gains, runs: Recorded) -> None:
    """One step of each, the better of a bold and a careful one. owners : their places among the filters"""
    linear = _linearise(states, owners, filters, runs)
    for state, found in zip(states, linear, strict=True):
        state.cost = _cost(found, state)
    tries = [
        [_moved(state, found, max(state.damping, least)) for state, found in zip(states, linear, strict=True)]
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


def slopes(found: Fitted, runs: Recorded) -> list[Term]:
    """What moves with a fitted twin, as terms of a twin beside it: its unknowns, frozen where they are."""
    state = _State(found.trial, found.free, found.coordinates)
    twin, steps = _nominal(state, state.x, runs)
    wanted = [Response(steps, start_of(twin, runs), steps.driven)]
    for other, moved in _neighbours(state, runs):
        wanted.append(Response(moved, start_of(other, runs), moved.driven))
    shown = responses(wanted)
    return [
        Term(
            ".".join(item.place),
            ((shown[1 + j] - shown[0]) / _difference(item, x)).T,
            item.sd,
            of_reading=True,
            mean=item.mean - x,
        )
        for j, (item, x) in enumerate(zip(found.free, found.coordinates, strict=True))
    ]


def gains_of(trial: Trial, terms: Sequence[Term], runs: Recorded) -> Floats:
    """What one more term brings a trial whose unknowns stand still, for each of `terms` [nats]."""
    state = _begun(replace(trial, nuisances=(*trial.nuisances, *terms), free=()))
    filters = _filters([state], runs, np.isfinite(runs.temp[:, 1:]))
    (found,) = _linearise([state], np.array([0]), filters, runs)
    own = len(trial.nuisances)
    normal, gradient = found.normal, found.gradient
    known = np.linalg.solve(normal[:own, :own], np.column_stack([normal[:own, own:], gradient[:own]]))
    left = gradient[own:] - normal[own:, :own] @ known[:, -1]
    size = np.diag(normal)[own:] - np.einsum("ti,it->t", normal[own:, :own], known[:, :-1])
    return np.asarray(0.5 * left**2 / size)


def _neighbours(state: _State, runs: Recorded) -> list[tuple[Twin, LinearSteps]]:
    """The twin a little off in each unknown."""
    found = []
    for j, item in enumerate(state.free):
        near = state.x.copy()
        near[j] += _difference(item, near[j])
        found.append(_at(state, near, runs))
    return found


def _linearise(states: list[_State], owners: Indices, filters: Gains, runs: Recorded) -> list[_Linearised]:
    """Residuals and their derivatives, whitened."""
    wanted: list[Response] = []
    counts = [1 + len(state.free) + len(state.trial.nuisances) for state in states]
    for state in states:
        twin, steps = _nominal(state, state.x, runs)
        wanted.append(Response(steps, start_of(twin, runs), steps.driven))
        for other, moved in _neighbours(state, runs):
            wanted.append(Response(moved, start_of(other, runs), moved.driven))
        wanted += [term.response(steps) for term in state.trial.nuisances]
    columns = _columns(responses(wanted), states, runs)
    white = whitened(filters, np.repeat(owners, counts), columns)
    parts = np.split(white.reshape(len(white), -1), np.cumsum(counts)[:-1])
    return [_normal(own, state) for own, state in zip(parts, states, strict=True)]


def _nominal(state: _State, x: Floats, runs: Recorded) -> tuple[Twin, LinearSteps]:
    """The twin there; where a step ends the next one begins."""
    place = x.tobytes()
    if place not in state.seen:
        while len(state.seen) >= REMEMBERED:
            del state.seen[next(iter(state.seen))]
        state.seen[place] = _at(state, x, runs)
    return state.seen[place]


def _at(state: _State, x: Floats, runs: Recorded) -> tuple[Twin, LinearSteps]:
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
        gradient[p + j] += term.mean / term.sd**2
    normal[:p, :p], gradient[:p] = _with_paths(normal[:p, :p], gradient[:p], state)
    return _Linearised(normal, gradient, float(residual @ residual), residual, slopes[p:])


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
    tried: list[Floats],
    states: list[_State],
    owners: Indices,
    linear: list[_Linearised],
    filters: Gains,
    runs: Recorded,
) -> Floats:
    """What the next place of each state would cost, by the terms from where it stands."""
    wanted = []
    for state, x in zip(states, tried, strict=True):
        twin, steps = _nominal(state, x, runs)
        wanted.append(Response(steps, start_of(twin, runs), steps.driven))
    white = whitened(filters, owners, np.nan_to_num(runs.temp[:, 1:]) - responses(wanted))
    costs = np.empty(len(tried))
    for j, (state, x, found) in enumerate(zip(states, tried, linear, strict=True)):
        residual, p = white[j].ravel(), len(state.free)
        means = np.array([term.mean / term.sd**2 for term in state.trial.nuisances])
        moved = replace(found, gradient=np.concatenate([found.gradient[:p], found.terms @ residual + means]))
        costs[j] = 0.5 * (float(residual @ residual) + _penalty(state, x)) - _explained(moved, p)
    return costs


def _finished(states: list[_State], runs: Recorded, measured: NDArray[np.bool_]) -> list[Fitted]:
    filters = _filters(states, runs, measured)
    linear = _linearise(states, np.arange(len(states)), filters, runs)
    found = []
    for i, (state, own) in enumerate(zip(states, linear, strict=True)):
        spreads = np.log(filters.sd[:, i].T)[measured].sum()
        p = len(state.free)
        inverse = np.asarray(np.linalg.pinv(own.normal, hermitian=True), dtype=np.float64)
        sizes = np.asarray(np.linalg.solve(own.normal[p:, p:], own.gradient[p:]))
        found.append(
            Fitted(
                state.trial,
                placed(state.trial.file, state.free, state.x),
                state.free,
                state.x,
                -_cost(own, state) - float(spreads),
                inverse,
                np.asarray((own.residual - sizes @ own.terms).reshape(measured.shape)),
                sizes,
                np.asarray(np.sqrt(np.diag(inverse)[p:])),
            )
        )
    return found
