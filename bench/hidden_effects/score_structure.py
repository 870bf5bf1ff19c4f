"""A twin of some effects as a likelihood of recorded runs: the scorer's own, apart from the workflow's.

Output error: a free run from rest of each run, with what is not known of each run alone (states at the start,
the mains) integrated out as normal, and noise as `score_noise` has it. Values that the file says are
uncertain are held to their priors; exact ones stay.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.score_noise import Noise, Whitener, likeliest, log_likelihood, whitener
from edge.twin.effects import EFFECTS, applied
from edge.twin.model import Twin
from edge.twin.recorded import Recorded
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value
from edge.twin.warm_start import at_rest, spread

Floats = NDArray[np.float64]
_LEAST = 1e-4  # of a positive parameter, share of the table's start
_INSIDE = 1e-6  # of a bound, so that a fit does not begin on it
_SURE_REL_SD = 0.005  # of a wall's loss at rest, where the file gives it as exact
_MAINS_STEP = 0.01
_CLOSE = 1e-4  # of a sum of squares of about the number of rows: a tenth of a nat
_MOST_EVALUATIONS = 25


@dataclass(frozen=True, slots=True)
class Unknown:
    """A value to be found: by its logarithm if it is positive, else in units of its start."""

    place: Place
    start: float
    low: float
    high: float
    prior_sd: float = np.inf

    @property
    def is_log(self) -> bool:
        return self.low >= 0.0 and self.start > 0.0

    @property
    def _unit(self) -> float:
        return abs(self.start) or 1.0

    def scaled(self, value: float) -> float:
        """The optimiser's number, inside the bounds."""
        low, high = self.bounds
        return float(np.clip(self._to(value), low + _INSIDE, high - _INSIDE))

    def value(self, scaled: float) -> float:
        natural = float(np.exp(scaled)) if self.is_log else scaled * self._unit
        return float(np.clip(natural, self.low, self.high))

    @property
    def bounds(self) -> tuple[float, float]:
        return self._to(self.low), self._to(self.high)

    def _to(self, value: float) -> float:
        if self.is_log:
            return float(np.log(max(value, self.low, _LEAST * self.start)))
        return value / self._unit


class Fit(NamedTuple):
    """log_likelihood : at the best values, without the constant; scaled : [p]"""

    log_likelihood: float
    scaled: Floats
    noise: Noise


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """A twin file of which some values are unknown, and the runs that tell them."""

    file: TwinFile
    data: Recorded
    unknowns: tuple[Unknown, ...]

    @property
    def start(self) -> Floats:
        return np.array([item.scaled(item.start) for item in self.unknowns])

    @property
    def measured(self) -> NDArray[np.bool_]:
        """[B, N]"""
        return np.isfinite(self.data.temp[:, 1:])

    def values(self, scaled: Floats) -> dict[Place, float]:
        return {item.place: item.value(float(x)) for item, x in zip(self.unknowns, scaled, strict=True)}

    def twin(self, scaled: Floats, mains: float = 1.0) -> Twin:
        """The twin of these values; mains : the heater's power, share of its own."""
        file = self.file.with_values({place: Value(value) for place, value in self.values(scaled).items()})
        if mains != 1.0:
            power = file.geometry["heater_max_w"].value * mains
            file = file.with_values({("geometry", "heater_max_w"): Value(power)})
        return file.twin()

    def residual(self, scaled: Floats) -> Floats:
        """Measured minus a free run from rest, [B, N]; 0 where nothing was measured [K]."""
        twin = self.twin(scaled)
        return self._missed(twin, self._rest(twin))

    def response(self, scaled: Floats) -> Floats:
        """What one sd of each state at the start, and of the mains if they vary, does: [B, q, N] [K]."""
        twin = self.twin(scaled)
        rest, spreads = self._rest(twin), spread(twin)
        usual = self._missed(twin, rest)
        moves = [usual - self._missed(twin, rest + sd * unit)
                 for sd, unit in zip(spreads, np.eye(len(spreads)), strict=True)]  # fmt: skip
        if varying := self.file.nuisance.get("heater_power_run_sd") or 0.0:
            stronger = self.twin(scaled, 1.0 + _MAINS_STEP)
            moves.append((usual - self._missed(stronger, rest)) * varying / _MAINS_STEP)
        return np.stack(moves, axis=1)

    def priors(self, scaled: Floats) -> Floats:
        """How far each value with a prior is from it, in standard deviations."""
        values = self.values(scaled)
        pulls = [(values[item.place] - item.start) / item.prior_sd
                 for item in self.unknowns if np.isfinite(item.prior_sd)]  # fmt: skip
        return np.array([*pulls, *self._wall_at_rest(values)])

    def _wall_at_rest(self, values: Mapping[Place, float]) -> list[float]:
        """A wall that stores heat loses, at rest, what the file says of the wall that it replaces."""
        if not {"wall_mass", "wall_loss"} <= set(self.file.effects):
            return []
        known = self.file.effects["wall_loss"]["UA"]
        inner, outer = (
            values.get(("effects", "wall_mass", name), self.file.effects["wall_mass"][name].value)
            for name in ("G_in", "G_out")
        )
        at_rest_w_k = inner * outer / (inner + outer)
        return [(at_rest_w_k / known.value - 1.0) / (known.rel_sd or _SURE_REL_SD)]

    def _rest(self, twin: Twin) -> Floats:
        first = zip(self.data.temp[:, 0], self.data.ambient[:, 0], strict=True)
        return np.stack([at_rest(twin, float(temp), float(room)) for temp, room in first])

    def _missed(self, twin: Twin, start: Floats) -> Floats:
        data = self.data
        predicted = twin.rollout(start, data.duty, data.fan, data.ambient, conditions=data.conditions or None)
        return np.where(self.measured, data.temp[:, 1:] - predicted, 0.0)


def structure(file: TwinFile, data: Recorded) -> Structure:
    """What of the file is to be found: values to be fitted and uncertain ones, of the effects that act."""
    if "ua_drift" in file.effects and file.day0_utc is None and "utc" in data.conditions:
        file = replace(file, day0_utc=float(data.conditions["utc"].min()))
    acting = applied(file.effects)
    unknowns = []
    for place, value in file.values().items():
        if not (value.fit or value.rel_sd is not None) or (place[0] == "effects" and place[1] not in acting):
            continue
        low, high = _range(place, value.value)
        prior_sd = np.inf if value.rel_sd is None else abs(value.rel_sd * value.value)
        unknowns.append(Unknown(place, value.value, low, high, prior_sd))
    return Structure(file, data, tuple(unknowns))


def fit(problem: Structure, start: Floats, noise: Noise, passes: int) -> Fit:
    """The likeliest values from `start`, [p], and then the likeliest noise; as often as there are passes."""
    scaled = start
    for _ in range(passes):
        response = problem.response(scaled)
        if len(scaled):
            scaled = _least_squares(problem, scaled, response, whitener(noise, problem.measured))
        residual = problem.residual(scaled)
        noise = likeliest(noise, residual, response, problem.measured)
    found = log_likelihood(noise, residual, response, problem.measured)
    return Fit(found - 0.5 * float((problem.priors(scaled) ** 2).sum()), scaled, noise)


def stacked(white: Floats, moved: Floats) -> Floats:
    """Columns [B, m, N] less what the runs' own unknowns [B, q, N] explain of them, and at which price.

    Returns : [B (N + q), m]; the sum of squares of a column is its quadratic form with those integrated out
    """
    normal = moved @ moved.swapaxes(1, 2) + np.eye(moved.shape[1])
    pull = np.linalg.solve(normal, moved @ white.swapaxes(1, 2))  # [B, q, m]
    left = white.swapaxes(1, 2) - moved.swapaxes(1, 2) @ pull
    return np.concatenate([left, pull], axis=1).reshape(-1, white.shape[1])


def _least_squares(problem: Structure, start: Floats, response: Floats, whiten: Whitener) -> Floats:
    from scipy.optimize import least_squares

    moved = whiten(response)

    def missed(scaled: Floats) -> Floats:
        white = whiten(problem.residual(scaled)[:, None])
        return np.concatenate([stacked(white, moved)[:, 0], problem.priors(scaled)])

    low, high = np.array([item.bounds for item in problem.unknowns]).T
    solved = least_squares(
        missed, start, bounds=(low, high), x_scale="jac", xtol=_CLOSE, ftol=_CLOSE, max_nfev=_MOST_EVALUATIONS
    )
    return np.asarray(solved.x, dtype=np.float64)


def _range(place: Place, start: float) -> tuple[float, float]:
    if place[0] == "geometry":
        return 0.1 * start, 10.0 * start
    parameter = EFFECTS[place[1]].parameter(place[2])
    return parameter.low, parameter.high
