"""Rivals of a hidden effect, sifted cheaply: only those that may come near the truth are fitted in full.

In the sieve the values of the true structure move in straight lines (its sensitivities at its fit), noise
stays as there, and the rival's own parameters are tried at a few places, then fitted alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.score_fit import LikelihoodFit, stack_columns
from bench.hidden_effects.score_noise import Whitener, whitener
from bench.hidden_effects.score_structure import Structure, structure
from edge.twin.effects.library import EFFECTS
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]
HOPELESS_NATS = 25.0  # behind the truth in the sieve, where the noise does not give way
LEAST_GAIN_NATS = 1.5  # over nothing in the effect's place, in the sieve
_HOPELESS_SHARE = 0.1  # of what the effect explains, on top, for a rival between the tried places
_TRIED = (0.25, 1.0, 4.0)
_STEP = 1e-4
_MOST_EVALUATIONS = 10


@dataclass(frozen=True, slots=True, eq=False)
class Sieve:
    """The true fit of a structure, seen from one of its effects.

    without : the structure with no effect in its place and all else as fitted
    slopes : of the residual by the p unknowns of the others, in standard deviations [B, p, N]
    prior, prior_slopes : [m] and [m, p]
    truth_nats : half the quadratic form of the true fit
    """

    without: Structure
    whiten: Whitener
    slopes: Floats
    prior: Floats
    prior_slopes: Floats
    truth_nats: float

    def start_of(self, name: str) -> Floats | None:
        """Return the rival's best parameters, as the optimiser has them [p]; None where it is hopeless."""
        file = self.without.file
        rival = self.without.other({**file.effects, name: unknown(name, file)})
        missed = _Remainder(self, rival, rival.start)
        places = _places(rival)
        tried = [missed(place) for place in places]
        if self._leaves_too_much(missed.without(), tried):
            return None
        found = _fit(missed, rival, places[int(np.argmin([each @ each for each in tried]))])
        nats = _nats(missed(found))
        is_hopeless = (
            nats - self.truth_nats > HOPELESS_NATS or _nats(missed.without()) - nats < LEAST_GAIN_NATS
        )
        return None if is_hopeless else found

    def _leaves_too_much(self, without: Floats, tried: list[Floats]) -> bool:
        """Return whether even a mixture of all signatures misses much of the effect's part."""
        signatures = np.stack([without - each for each in tried], axis=1)
        left = without - signatures @ np.linalg.lstsq(signatures, without, rcond=1e-9)[0]
        explained = max(0.0, _nats(without) - self.truth_nats)
        return _nats(left) - self.truth_nats > HOPELESS_NATS + _HOPELESS_SHARE * explained


def sieve(truth: Structure, fit: LikelihoodFit, effect: str) -> Sieve:
    """Return the sieve for the rivals of `effect`, from the fit of the true structure."""
    others = [i for i, item in enumerate(truth.unknowns) if item.place[:2] != ("effects", effect)]
    whiten = whitener(fit.noise, truth.measured)
    residual, prior = truth.residual(fit.scaled), truth.priors(fit.scaled)
    slopes, prior_slopes = [], []
    for i in others:
        moved = fit.scaled.copy()
        moved[i] += _STEP if moved[i] + _STEP < truth.unknowns[i].bounds[1] else -_STEP
        step = moved[i] - fit.scaled[i]
        slopes.append((truth.residual(moved) - residual) / step)
        prior_slopes.append((truth.priors(moved) - prior) / step)
    missed = stack_columns(whiten(residual[:, None]), whiten(truth.response(fit.scaled)))[:, 0]
    shape = (len(others), *residual.shape)
    return Sieve(
        _without(truth, fit, effect),
        whiten,
        whiten(np.moveaxis(np.array(slopes).reshape(shape), 0, 1)),
        prior,
        np.array(prior_slopes).reshape(len(others), len(prior)).T,
        _nats(missed) + _nats(prior),
    )


def unknown(name: str, file: TwinFile, truth: Mapping[str, float] | None = None) -> dict[str, Value]:
    """Return an effect to be fitted in a file, begun at its true parameters where there are any.

    Else it begins where the table says; a wall that stores heat as lossy as the one that it replaces.
    """
    starts = {item.name: item.start for item in EFFECTS[name].parameters}
    if name == "wall_mass" and "wall_loss" in file.effects:
        starts |= {"G_in": 2.0 * file.effects["wall_loss"]["UA"].value}
        starts |= {"G_out": starts["G_in"]}
    return {key: Value((truth or {}).get(key, start), fit=True) for key, start in starts.items()}


def _without(truth: Structure, fit: LikelihoodFit, effect: str) -> Structure:
    file = truth.file
    exact = {place: Value(value.value) for place, value in file.values().items()}
    found = {place: Value(value) for place, value in truth.values(fit.scaled).items()}
    file = file.with_values(exact | found)
    exactly = structure(file, truth.data, truth.mains_sd, truth.curve)
    return exactly.other({name: own for name, own in file.effects.items() if name != effect})


class _Remainder:
    """The remainder of a rival at its parameters after everything else has adapted."""

    def __init__(self, sieve: Sieve, rival: Structure, start: Floats) -> None:
        self._sieve, self._rival = sieve, rival
        self._moved = sieve.whiten(rival.response(start))
        slopes = np.concatenate([stack_columns(sieve.slopes, self._moved), sieve.prior_slopes])
        self._basis = np.linalg.qr(slopes)[0]

    def __call__(self, scaled: Floats) -> Floats:
        """Return errors in standard deviations; the rival's own priors come last."""
        return np.concatenate([self._remainder(self._rival.residual(scaled)), self._rival.priors(scaled)])

    def without(self) -> Floats:
        """Return the errors without anything in the effect's place."""
        left = self._remainder(self._sieve.without.residual(np.zeros(0)))
        return np.concatenate([left, np.zeros(len(self._rival.priors(self._rival.start)))])

    def _remainder(self, residual: Floats) -> Floats:
        white = stack_columns(self._sieve.whiten(residual[:, None]), self._moved)[:, 0]
        missed = np.concatenate([white, self._sieve.prior])
        return np.asarray(missed - self._basis @ (self._basis.T @ missed))


def _places(rival: Structure) -> list[Floats]:
    """Return combinations of a few values of each parameter; of the first alone where there are three."""
    tried = []
    for i, item in enumerate(rival.unknowns):
        values = [item.start * factor for factor in _TRIED] if item.is_log else [-item.start, item.start]
        few = values if i == 0 or len(rival.unknowns) < 3 else [item.start]
        tried.append([item.scale(value) for value in few])
    return [np.array(place) for place in product(*tried)]


def _fit(missed: _Remainder, rival: Structure, start: Floats) -> Floats:
    from scipy.optimize import least_squares

    low, high = np.array([item.bounds for item in rival.unknowns]).T
    solved = least_squares(
        missed, start, bounds=(low, high), x_scale="jac", max_nfev=_MOST_EVALUATIONS, ftol=1e-4
    )
    return np.asarray(solved.x, dtype=np.float64)


def _nats(missed: Floats) -> float:
    return 0.5 * float(missed @ missed)
