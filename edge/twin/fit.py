"""Parameters of a twin from recorded runs: least squares on the error of free runs, with 95 % intervals.

A free run is linear in its start, so the starts are found in closed form at any parameters (variable
projection; Golub & Pereyra 2003, Inverse Problems 19), held to a prior: rest, give or take `spread`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun
from edge.twin.effects.library import acting_effects, day_counter, parameter_at
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch, batch_runs
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import SDS_95, Value
from edge.twin.warm_start import at_rest, spread

Floats = NDArray[np.float64]


class FreeRun(NamedTuple):
    """Free runs of B runs from their best starts.

    residual : [B, N], measured minus predicted after each step; 0 where nothing was measured [K]
    measured : [B, N], whether it was
    start_pull : [B, n], how far each start is from its prior, in standard deviations
    """

    residual: Floats
    measured: NDArray[np.bool_]
    start_pull: Floats


def free_run(twin: BoxTwin, runs: RunBatch, ambient: Floats, noise_k: float) -> FreeRun:
    """Simulate the runs with the recorded inputs.

    ambient : [B, N] [°C]; noise_k : sd of what a free run misses, against which the prior is weighed [K]
    """
    count, size = len(runs.temp), len(twin.states)
    rest = np.stack(
        [at_rest(twin, temp, room) for temp, room in zip(runs.temp[:, 0], ambient[:, 0], strict=True)]
    )
    conditions = runs.conditions or None
    predicted = twin.rollout(rest, runs.duty, runs.fan, ambient, conditions=conditions)
    measured = runs.measured
    residual = np.where(measured, runs.temp[:, 1:] - predicted, 0.0)
    response = _responses(twin, runs, rest, ambient, predicted).reshape(count, size, -1)
    response = response * measured[:, None, :]
    response *= spread(twin)[:, None] / noise_k
    normal = response @ response.swapaxes(1, 2) + np.eye(size)
    pull = np.linalg.solve(normal, response @ (residual / noise_k)[:, :, None])[:, :, 0]
    explained = noise_k * np.einsum("bi,bik->bk", pull, response)
    return FreeRun(residual - explained, measured, np.asarray(pull, dtype=np.float64))


def _responses(twin: BoxTwin, runs: RunBatch, rest: Floats, ambient: Floats, predicted: Floats) -> Floats:
    """Return the sensor's response to a unit of each initial state, [B n, N]."""
    count, size = rest.shape
    unit = np.repeat(np.eye(size)[None], count, axis=0).reshape(-1, size)
    fans = np.repeat(runs.fan, size, axis=0)
    if twin.signals.plain:
        return twin.rollout(unit, np.zeros_like(fans), fans, 0.0)  # nothing but that state
    every = {name: np.repeat(column, size, axis=0) for name, column in runs.conditions.items()}
    duties, rooms = np.repeat(runs.duty, size, axis=0), np.repeat(ambient, size, axis=0)
    moved = twin.rollout(np.repeat(rest, size, axis=0) + unit, duties, fans, rooms, conditions=every)
    return moved - np.repeat(predicted, size, axis=0)


def rmse(run: FreeRun) -> float:
    """Root mean square of what was measured [K]."""
    return float(np.sqrt((run.residual**2).sum() / run.measured.sum()))


GEOMETRY_RANGE = (0.01, 100.0)  # of a geometry value that is fitted, shares of its start
AMBIENT_RANGE_C = (-20.0, 60.0)
CORRELATED_S = 1800.0  # of the paper's box: errors of a free run closer than this go together
FINE = float(np.sqrt(np.finfo(float).eps))  # share of a value, by which SciPy takes differences


@dataclass(frozen=True, slots=True)
class FittedValue:
    """A fitted value with its 95 % interval, cut at the bounds."""

    value: float
    sd: float
    low: float
    high: float
    at_bound: bool


@dataclass(frozen=True, slots=True)
class TwinFit:
    """A fitted twin and how well it fits.

    file : the twin file with the fitted values and their intervals
    ambient_c : the room temperature that fits best, where none was recorded
    rmse_k, rows : of the free runs that it was fitted on
    """

    file: TwinFile
    estimates: dict[Place, FittedValue]
    ambient_c: FittedValue | None
    rmse_k: float
    rows: int


@dataclass(frozen=True, slots=True)
class _Unknown:
    """One number to be found."""

    place: Place
    start: float
    low: float
    high: float
    prior_sd: float = np.inf

    @property
    def scale(self) -> float:
        """A number of its size."""
        return abs(self.start) or self.high - self.low


_AMBIENT: Place = ("temp_ambient_c",)


def fit_twin(file: TwinFile, runs: Sequence[RecordedRun]) -> TwinFit:
    """Find what `file` says is to be fitted, and correct what it says is uncertain, on all runs together.

    Each run begins with hidden states of its own, found with the rest. Where no run has a room temperature,
    one constant is fitted for all. Intervals allow for errors that go together in time (Newey & West 1987).
    Values that only a ratio is known of, like the scale of all heats and capacities, get intervals as wide as
    their bounds: give one of them as exact.

    Errors : DataError for nothing to fit, a run that may not be fitted on, a parameter that does nothing
    """
    data = batch_runs(runs, file.sample_s)
    if day_counter(file.effects) and file.day0_utc is None and "utc" in data.conditions:
        file = replace(file, day0_utc=float(data.conditions["utc"].min()))  # the first run's start
    unknowns = _unknowns(file, data)
    start = np.array([item.start / item.scale for item in unknowns])
    noise_k = file.twin().noise.sensor_k
    # Twice: the first pass tells how far a free run is off, against which priors weigh in the second.
    for _ in range(2):
        problem = _Problem(file, data, tuple(unknowns), noise_k)
        solution = problem.solve(start)
        start, noise_k = solution.x, max(noise_k, rmse(problem.free_run(solution.x)))
    found = problem.free_run(start)
    estimates = _estimates(problem, start, solution.jac, found)
    return TwinFit(
        file.with_values(
            {
                place: Value(item.value, low=item.low, high=item.high)
                for place, item in estimates.items()
                if place != _AMBIENT
            }
        ),
        {place: item for place, item in estimates.items() if place != _AMBIENT},
        estimates.get(_AMBIENT),
        rmse(found),
        int(found.measured.sum()),
    )


@dataclass(frozen=True, slots=True)
class _Problem:
    """Residuals over unknowns, each in units of its scale."""

    file: TwinFile
    data: RunBatch
    unknowns: tuple[_Unknown, ...]
    noise_k: float

    def free_run(self, scaled: Floats) -> FreeRun:
        values = {item.place: float(x) * item.scale for item, x in zip(self.unknowns, scaled, strict=True)}
        room = values.pop(_AMBIENT, None)
        ambient = self.data.ambient if room is None else np.full_like(self.data.ambient, room)
        twin = self.file.with_values({place: Value(value) for place, value in values.items()}).twin()
        return free_run(twin, self.data, ambient, self.noise_k)

    def residuals(self, scaled: Floats) -> Floats:
        """Return errors of the temperatures, then of the starts, then of the
        priors, in standard deviations.
        """
        run = self.free_run(scaled)
        priors = [
            (x * item.scale - item.start) / item.prior_sd
            for item, x in zip(self.unknowns, scaled, strict=True)
        ]
        return np.concatenate([run.residual.ravel() / self.noise_k, run.start_pull.ravel(), priors])

    def solve(self, start: Floats) -> Any:
        from scipy.optimize import least_squares

        scales = np.array([item.scale for item in self.unknowns])
        bounds = (
            np.array([item.low for item in self.unknowns]) / scales,
            np.array([item.high for item in self.unknowns]) / scales,
        )
        inside = np.clip(start, bounds[0] + 1e-9, bounds[1] - 1e-9)
        return least_squares(
            self.residuals, inside, bounds=bounds, x_scale="jac", diff_step=self._difference_steps()
        )

    def _difference_steps(self) -> Floats | None:
        """Share of each unknown; None where SciPy's are long enough for all."""
        found = [parameter_at(item.place) for item in self.unknowns]
        steps = [item.difference if item else None for item in found]
        return np.array([step or FINE for step in steps]) if any(steps) else None


def _unknowns(file: TwinFile, data: RunBatch) -> list[_Unknown]:
    unknowns = []
    for place, value in file.values().items():
        if not (value.fit or value.rel_sd is not None):
            continue
        low, high = _range(file, place, value.value)
        prior_sd = np.inf if value.rel_sd is None else abs(value.rel_sd * value.value)
        unknowns.append(_Unknown(place, value.value, low, high, prior_sd))
        if place[0] == "effects" and place[1] not in acting_effects(file.effects):
            raise DataError(f"{'.'.join(place)}: does nothing beside the effect that replaces it")
    if np.isfinite(data.ambient).any() and not data.has_ambient:
        # One room for all would be fitted as if it had been measured in each.
        raise DataError("temp_ambient_c: some runs have it and others not: fit those with it alone")
    if not data.has_ambient:
        unknowns.append(_Unknown(_AMBIENT, float(np.nanmin(data.temp[:, 0])), *AMBIENT_RANGE_C))
    if not unknowns:
        raise DataError("fit: no value of the twin is to be fitted ({fit: true}) or uncertain (rel_sd)")
    return unknowns


def _range(file: TwinFile, place: Place, start: float) -> tuple[float, float]:
    if place[0] == "geometry":
        return GEOMETRY_RANGE[0] * start, GEOMETRY_RANGE[1] * start
    parameter = file.usual(place)
    return parameter.low, parameter.high


def _estimates(problem: _Problem, scaled: Floats, jacobian: Floats, run: FreeRun) -> dict[Place, FittedValue]:
    rows = run.residual.size
    scores = (jacobian[:rows] * (run.residual.ravel() / problem.noise_k)[:, None]).reshape(
        *run.residual.shape, -1
    )
    information = jacobian.T @ jacobian
    inverse = np.linalg.pinv(information, hermitian=True)
    lags = max(1, round(CORRELATED_S * problem.file.scale.time / problem.file.sample_s))
    prior = jacobian[rows:]
    spread = inverse @ (_long_run(scores, lags) + prior.T @ prior) @ inverse
    sds = np.sqrt(np.maximum(np.diag(spread), 0.0))
    flat = np.diag(information) == 0.0
    if flat.any():
        place = problem.unknowns[int(flat.argmax())].place
        raise DataError(f"{'.'.join(place)}: these runs do not tell it: it changes nothing in them")
    return {
        item.place: _estimate(item, x * item.scale, sd * item.scale)
        for item, x, sd in zip(problem.unknowns, scaled, sds, strict=True)
    }


def _estimate(item: _Unknown, value: float, sd: float) -> FittedValue:
    low, high = max(value - SDS_95 * sd, item.low), min(value + SDS_95 * sd, item.high)
    margin = 1e-6 * (item.high - item.low)
    at_bound = not item.low + margin < value < item.high - margin
    return FittedValue(float(value), float(sd), float(low), float(high), bool(at_bound))


def _long_run(scores: Floats, lags: int) -> Floats:
    """Sum of the scores' covariances up to `lags` rows apart, Bartlett weights; scores : [B, N, p]."""
    total: Floats = np.einsum("bti,btj->ij", scores, scores)
    for lag in range(1, min(lags, scores.shape[1] - 1) + 1):
        apart = np.einsum("bti,btj->ij", scores[:, lag:], scores[:, :-lag])
        total += (1.0 - lag / (lags + 1.0)) * (apart + apart.T)
    return total
