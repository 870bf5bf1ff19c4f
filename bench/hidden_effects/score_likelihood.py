"""A twin of some effects as a likelihood of recorded runs, and its fit: the scorer's own, not the workflow's.

Output error: a free run from rest of each run, with what is not known of each run alone (states at the start,
the mains) integrated out as normal, and the noise below. Values that the file says are
uncertain are held to their priors; exact ones stay. Heat that depends on the air's temperature other than in
proportion (what radiation has beyond its tangent, evaporation) is taken at the measured temperature: a free
run near the truth is as near as the noise, and some forty times faster so. What a case has beside its effects
without saying so (walls whose loss bends) is part of every structure.

Noise of free runs of the true equations is white, and correlated in time.
The covariance between rows i and j of a run is w^2 [i = j] + a^2 phi^|i - j|: the sensor, and heat that
nobody recorded on its way through the box. A scalar Kalman filter takes it apart in order N (Anderson & Moore
1979, Optimal Filtering, ch. 5); a missing row is left out.
`fit` finds the likeliest values of a structure and of its noise.
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.equations import CURVE_AT_K
from edge.twin.effects.library import EFFECTS, acting_effects
from edge.twin.model import BoxTwin
from edge.twin.network import HEATER
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value
from edge.twin.warm_start import at_rest, hold

Floats = NDArray[np.float64]
LEAST_SD_K = 1e-3
_LONGEST_ROWS = 500.0  # a correlation beyond this is an offset, which would take the place of effects
_LEAST_SHARE, _START_ROWS = 0.3, (3.0, 60.0)  # of a start
_MOST_NOISE_EVALUATIONS = 80
_LEAST = 1e-4  # of a positive parameter, share of the table's start
_INSIDE = 1e-6  # of a bound, so that a fit does not begin on it
_SURE_REL_SD = 0.005  # of a wall's loss at rest, where the file gives it as exact
_MAINS_STEP = 0.01
_BODY_START_K, _HEATER_START_W = 1.0, 3.0
_CLOSE = 1e-4  # of a sum of squares of about the number of rows: a tenth of a nat
_MOST_FIT_EVALUATIONS = 25
_WORTH_NATS = 0.1  # that a further pass must bring


class ReadingNoise(NamedTuple):
    """white_k : w; wandering_k : a [K]; rows : over which the wandering falls to 1/e, -1 / log(phi)."""

    white_k: float
    wandering_k: float
    rows: float

    @property
    def phi(self) -> float:
        """From one row to the next."""
        return float(np.exp(-1.0 / self.rows))


class Whitener(NamedTuple):
    """The filter of B runs of N rows. gain, scale : [B, N]; scale is 1 / sd of an innovation, 0: missing."""

    phi: float
    gain: Floats
    scale: Floats
    log_det: float

    def __call__(self, columns: Floats) -> Floats:
        """Columns [B, m, N] as innovations in standard deviations, 0 where a row is missing."""
        in_time = np.ascontiguousarray(np.moveaxis(columns, 2, 0))
        innovations = np.empty_like(in_time)
        state = np.zeros(in_time.shape[1:])
        for k, now in enumerate(in_time):
            innovation = now - state
            innovations[k] = innovation * self.scale[:, k, None]
            state = self.phi * (state + self.gain[:, k, None] * innovation)
        return np.moveaxis(innovations, 0, 2)


def whitener(noise: ReadingNoise, measured: NDArray[np.bool_]) -> Whitener:
    """Return the filter for runs with these rows measured, [B, N]."""
    phi, gain, variance = noise.phi, np.zeros(measured.shape), np.ones(measured.shape)
    known = np.full(len(measured), noise.wandering_k**2)  # variance of the wandering before each row
    for k in range(measured.shape[1]):
        variance[:, k] = known + noise.white_k**2
        gain[:, k] = np.where(measured[:, k], known / variance[:, k], 0.0)
        left = known * (1.0 - gain[:, k])
        known = phi**2 * left + (1.0 - phi**2) * noise.wandering_k**2
    scale = np.where(measured, 1.0 / np.sqrt(variance), 0.0)
    return Whitener(phi, gain, scale, float(np.log(variance[measured]).sum()))


def log_likelihood(
    noise: ReadingNoise, residual: Floats, response: Floats, measured: NDArray[np.bool_]
) -> float:
    """Return the log likelihood of the residuals [B, N], with q unknowns of
    every run integrated out; without the constant.

    response : [B, q, N], what one standard deviation of each unknown does: states at the start, mains
    """
    whiten = whitener(noise, measured)
    white = whiten(np.concatenate([residual[:, None], response], axis=1))
    own, moved = white[:, 0], white[:, 1:]
    normal = moved @ moved.swapaxes(1, 2) + np.eye(moved.shape[1])
    slope = np.einsum("bqn,bn->bq", moved, own)
    explained = np.einsum("bq,bq->", slope, np.linalg.solve(normal, slope[..., None])[..., 0])
    spread = whiten.log_det + float(np.linalg.slogdet(normal)[1].sum())
    return -0.5 * float((own**2).sum() - explained + spread)


def likeliest(
    start: ReadingNoise, residual: Floats, response: Floats, measured: NDArray[np.bool_]
) -> ReadingNoise:
    """Find the noise under which the residuals are likeliest, by the simplex of Nelder & Mead from `start`.

    From a start that hardly wanders, or over hardly any rows, no small step leads away: it is moved first.
    """
    from scipy.optimize import minimize

    def noise(logs: Floats) -> ReadingNoise:
        white, wandering, rows = np.exp(np.clip(logs, -20.0, 20.0))
        return ReadingNoise(
            max(float(white), LEAST_SD_K),
            max(float(wandering), LEAST_SD_K),
            float(np.clip(rows, 0.2, _LONGEST_ROWS)),
        )

    # Logarithms: all three are positive, and differ by powers of ten.
    white, wandering, rows = start
    begun = np.log([white, max(wandering, _LEAST_SHARE * white), np.clip(rows, *_START_ROWS)])
    found = minimize(
        lambda logs: -log_likelihood(noise(logs), residual, response, measured),
        begun,
        method="Nelder-Mead",
        options={"maxfev": _MOST_NOISE_EVALUATIONS, "fatol": 0.02, "xatol": 0.02},
    )
    return noise(found.x)


@dataclass(frozen=True, slots=True)
class SoughtValue:
    """A value to be found: by its logarithm if it is positive, else in units of its start."""

    place: Place
    start: float
    low: float
    high: float
    prior_sd: float = np.inf

    @property
    def is_log(self) -> bool:
        """True where the optimiser moves the logarithm: values that cannot be negative."""
        return self.low >= 0.0 and self.start > 0.0

    @property
    def _unit(self) -> float:
        return abs(self.start) or 1.0

    def scale(self, value: float) -> float:
        """Return the optimiser's number, inside the bounds."""
        low, high = self.bounds
        return float(np.clip(self._to(value), low + _INSIDE, high - _INSIDE))

    def value(self, scaled: float) -> float:
        """Return the value in its own unit, inside its range."""
        natural = float(np.exp(scaled)) if self.is_log else scaled * self._unit
        return float(np.clip(natural, self.low, self.high))

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest number of the optimiser."""
        return self._to(self.low), self._to(self.high)

    def _to(self, value: float) -> float:
        if self.is_log:
            return float(np.log(max(value, self.low, _LEAST * self.start)))
        return value / self._unit


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """A twin file of which some values are unknown, and the runs that tell them."""

    file: TwinFile
    data: RunBatch
    unknowns: tuple[SoughtValue, ...]
    middle: Floats  # the measured temperature in the middle of each step, [B, N]
    mains_sd: float = 0.0  # of the heater's power from run to run, share
    curve: float = 0.0  # by which the walls' loss grows per 10 K, share

    def other(self, effects: Mapping[str, Mapping[str, Value]]) -> "Structure":
        """Return the structure of the same runs with other effects."""
        file = replace(self.file, effects=effects)
        return structure(file, self.data, self.mains_sd, self.curve)

    @property
    def start(self) -> Floats:
        """Start of every unknown, scaled [n]."""
        return np.array([item.scale(item.start) for item in self.unknowns])

    @property
    def measured(self) -> NDArray[np.bool_]:
        """[B, N]"""
        return np.isfinite(self.data.temp[:, 1:])

    def values(self, scaled: Floats) -> dict[Place, float]:
        """Return the unknowns by place, in their own units. scaled : [n]"""
        return {item.place: item.value(float(x)) for item, x in zip(self.unknowns, scaled, strict=True)}

    def twin(self, scaled: Floats, mains: float = 1.0) -> BoxTwin:
        """Return the twin of these values. mains : the heater's power, share of its own"""
        file = self.file.with_values({place: Value(value) for place, value in self.values(scaled).items()})
        if mains != 1.0:
            power = file.geometry["heater_max_w"].value * mains
            file = file.with_values({("geometry", "heater_max_w"): Value(power)})
        return file.twin()

    def residual(self, scaled: Floats) -> Floats:
        """Measured minus a free run from rest, [B, N]; 0 where nothing was measured [K]."""
        twin = self.twin(scaled)
        return self._misfit(twin, self._rest(twin))

    def response(self, scaled: Floats) -> Floats:
        """Return the response to one sd of each initial state, and of the mains
        if they vary: [B, q, N] [K].
        """
        twin = self.twin(scaled)
        rest, spreads = self._rest(twin), _start_sd(twin)
        usual = self._misfit(twin, rest)
        moves = [usual - self._misfit(twin, rest + sd * unit)
                 for sd, unit in zip(spreads, np.eye(len(spreads)), strict=True)]  # fmt: skip
        if self.mains_sd:
            stronger = self.twin(scaled, 1.0 + _MAINS_STEP)
            moves.append((usual - self._misfit(stronger, rest)) * self.mains_sd / _MAINS_STEP)
        return np.stack(moves, axis=1)

    def priors(self, scaled: Floats) -> Floats:
        """How far each value with a prior is from it, in standard deviations."""
        values = self.values(scaled)
        pulls = [(values[item.place] - item.start) / item.prior_sd
                 for item in self.unknowns if np.isfinite(item.prior_sd)]  # fmt: skip
        return np.array([*pulls, *self._wall_at_rest(values)])

    def _wall_at_rest(self, values: Mapping[Place, float]) -> list[float]:
        """Return the errors of a heavy wall's loss at rest against the loss that
        the file states for the replaced wall.
        """
        if not {"wall_mass", "wall_loss"} <= set(self.file.effects):
            return []
        known = self.file.effects["wall_loss"]["UA"]
        inner, outer = (
            values.get(("effects", "wall_mass", name), self.file.effects["wall_mass"][name].value)
            for name in ("G_in", "G_out")
        )
        at_rest_w_k = inner * outer / (inner + outer)
        return [(at_rest_w_k / known.value - 1.0) / (known.rel_sd or _SURE_REL_SD)]

    def _rest(self, twin: BoxTwin) -> Floats:
        first = zip(self.data.temp[:, 0], self.data.ambient[:, 0], strict=True)
        return np.stack([at_rest(twin, float(temp), float(room)) for temp, room in first])

    def _misfit(self, twin: BoxTwin, start: Floats) -> Floats:
        data = self.data
        heat_w = self._bent_w(twin)
        source = heat_w / twin.system.air_capacity_j_k
        twin = _unbent(twin) if twin.signals.bends else twin
        conditions = data.conditions or None
        predicted = twin.rollout(start, data.duty, data.fan, data.ambient, source, conditions=conditions)
        return np.where(self.measured, data.temp[:, 1:] - predicted, 0.0)

    def _bent_w(self, twin: BoxTwin) -> Floats:
        """Heat that is not in proportion to the temperature, at the measured one [B, N]."""
        data = self.data
        bent = twin.signals.heat_w(self.middle, data.ambient, data.conditions, by_temp=True)
        excess, share, loss_w_k = self.middle - data.ambient, 1.0, 0.0
        if "wall_mass" in twin.effects:
            wall = twin.effects["wall_mass"]
            share = wall["G_in"] / (wall["G_in"] + wall["G_out"])  # of what the wall loses, that the air does
            loss_w_k = wall["G_out"]
        elif "wall_loss" in twin.effects:
            loss_w_k = twin.effects["wall_loss"]["UA"]
        beyond = share * excess
        return bent - share * loss_w_k * self.curve * (beyond - CURVE_AT_K) / 10.0 * beyond


def structure(file: TwinFile, data: RunBatch, mains_sd: float = 0.0, curve: float = 0.0) -> Structure:
    """Return the unknowns of the file: values to be fitted and uncertain ones, of the effects that act."""
    if "ua_drift" in file.effects and file.day0_utc is None and "utc" in data.conditions:
        file = replace(file, day0_utc=float(data.conditions["utc"].min()))
    acting = acting_effects(file.effects)
    unknowns = []
    for place, value in file.values().items():
        if not (value.fit or value.rel_sd is not None) or (place[0] == "effects" and place[1] not in acting):
            continue
        low, high = _range(place, value.value)
        prior_sd = np.inf if value.rel_sd is None else abs(value.rel_sd * value.value)
        unknowns.append(SoughtValue(place, value.value, low, high, prior_sd))
    temp = np.stack([hold(values) for values in data.temp])
    return Structure(file, data, tuple(unknowns), 0.5 * (temp[:, :-1] + temp[:, 1:]), mains_sd, curve)


def _start_sd(twin: BoxTwin) -> Floats:
    """How far each state may be from rest [n]; cases begin near it, with the heater off or nearly so."""
    hidden = [_HEATER_START_W if name == HEATER else _BODY_START_K for name in twin.states[1:]]
    return np.array([twin.noise.sensor_k, *hidden])


def _unbent(twin: BoxTwin) -> BoxTwin:
    """Return the twin without heat that depends on its temperature."""
    straight = copy.copy(twin)
    heats = [heat for heat in twin.signals.heats if not heat.by_temp]
    object.__setattr__(straight, "signals", replace(twin.signals, heats=heats))  # frozen for all but this
    return straight


def _range(place: Place, start: float) -> tuple[float, float]:
    if place[0] == "geometry":
        return 0.1 * start, 10.0 * start
    parameter = EFFECTS[place[1]].parameter(place[2])
    return parameter.low, parameter.high


class LikelihoodFit(NamedTuple):
    """log_likelihood : at the best values, without the constant; scaled : [p]"""

    log_likelihood: float
    scaled: Floats
    noise: ReadingNoise


def fit(problem: Structure, start: Floats, noise: ReadingNoise, passes: int) -> LikelihoodFit:
    """Fit the likeliest values from `start`, [p], then the likeliest noise, alternating while it helps.

    passes : at most
    """
    scaled, best = start, -np.inf
    for _ in range(passes):
        response = problem.response(scaled)
        if len(scaled):
            scaled = _least_squares(problem, scaled, response, whitener(noise, problem.measured))
        residual = problem.residual(scaled)
        noise = likeliest(noise, residual, response, problem.measured)
        before, best = best, log_likelihood(noise, residual, response, problem.measured)
        best -= 0.5 * float((problem.priors(scaled) ** 2).sum())
        if best - before < _WORTH_NATS:
            break
    return LikelihoodFit(best, scaled, noise)


def stack_columns(white: Floats, moved: Floats) -> Floats:
    """Columns [B, m, N] less what the runs' own unknowns [B, q, N] explain of them, and at which price.

    Returns : [B (N + q), m]; the sum of squares of a column is its quadratic form with those integrated out
    """
    if not white.shape[1]:
        return np.zeros((moved.shape[0] * (moved.shape[1] + moved.shape[2]), 0))
    normal = moved @ moved.swapaxes(1, 2) + np.eye(moved.shape[1])
    pull = np.linalg.solve(normal, moved @ white.swapaxes(1, 2))  # [B, q, m]
    left = white.swapaxes(1, 2) - moved.swapaxes(1, 2) @ pull
    return np.concatenate([left, pull], axis=1).reshape(-1, white.shape[1])


def _least_squares(problem: Structure, start: Floats, response: Floats, whiten: Whitener) -> Floats:
    from scipy.optimize import least_squares

    moved = whiten(response)

    def misfit(scaled: Floats) -> Floats:
        white = whiten(problem.residual(scaled)[:, None])
        return np.concatenate([stack_columns(white, moved)[:, 0], problem.priors(scaled)])

    low, high = np.array([item.bounds for item in problem.unknowns]).T
    solved = least_squares(
        misfit,
        start,
        bounds=(low, high),
        x_scale="jac",
        xtol=_CLOSE,
        ftol=_CLOSE,
        max_nfev=_MOST_FIT_EVALUATIONS,
    )
    return np.asarray(solved.x, dtype=np.float64)
