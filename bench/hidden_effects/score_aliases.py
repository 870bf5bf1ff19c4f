"""Which effects the training runs can't tell from a hidden one: set by the scorer, never by the workflow.

The true structure (what the twin file declares and all hidden effects) is fitted by maximum likelihood, and
so is each structure in which one hidden effect is replaced by another of the library, its noise as well as
its values. A rival of more parameters than the effect pays 1/2 log n for each (Schwarz 1978), or a wall that
stores heat would stand for every wall that does not; one of fewer gets nothing. A member of the effect's
class is at most ALIAS_NATS behind the truth, at most BETTER_NATS ahead of it (by chance; what fits better by
more mends something else), and gains ALIAS_NATS over nothing in the effect's place. Where the effect itself
gains less, nothing can stand for it. Rows further than OUTLIER_SD from the true fit are left out. An effect
whose column the runs don't have (`door_open`: when the door was open) is no rival, and as a hidden effect has
none.

Rivals are sifted cheaply first: only those that may come near the truth are fitted in full. In the sieve the
values of the true structure move in straight lines (its sensitivities at its fit), noise stays as there, and
the rival's own parameters are tried at a few places, then fitted alone.
"""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.cases import HiddenEffect, Truth
from bench.hidden_effects.score_likelihood import (
    LikelihoodFit,
    ReadingNoise,
    Structure,
    Whitener,
    fit,
    stack_columns,
    structure,
    whitener,
)
from edge.formats.run_file import RecordedRun
from edge.twin.effects.further import FURTHER_EFFECTS
from edge.twin.effects.library import EFFECTS, USUAL_EFFECTS, acting_effects
from edge.twin.run_batch import RunBatch, batch_runs
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]
HOPELESS_NATS = 25.0  # behind the truth in the sieve, where the noise does not give way
LEAST_GAIN_NATS = 1.5  # over nothing in the effect's place, in the sieve
_HOPELESS_SHARE = 0.1  # of what the effect explains, on top, for a rival between the tried places
_TRIED = (0.25, 1.0, 4.0)
_STEP = 1e-4
_MOST_EVALUATIONS = 10
METHOD_VERSION = 4  # classes of another version are computed anew
ALIAS_NATS = 3.0
BETTER_NATS = 6.0  # by which a rival is ahead in one case of exp(6) = 400 at most
KEPT_NATS = 10.0  # rivals further behind are not written down
SECOND_LOOK_NATS = 20.0  # rivals further behind after one pass get no second
OUTLIER_SD = 6.0
_TRUTH_PASSES = 6
_FIRST_NOISE = ReadingNoise(0.1, 0.1, 20.0)
_WITHOUT_A_COLUMN = ("door_opening",)  # the runs don't say when the door was open


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


@dataclass(frozen=True, slots=True)
class AliasClass:
    """The effects that a hidden effect cannot be told from.

    behind : nats by which each rival fits worse than the truth, KEPT_NATS at most; below 0 it fits better
    gain_nats : of the effect over nothing in its place; None where that can't be told
    """

    effect: str
    behind: Mapping[str, float] = field(default_factory=dict)
    gain_nats: float | None = None

    @property
    def members(self) -> frozenset[str]:
        """As near as that, the effect itself among them."""
        return self.within(ALIAS_NATS)

    def within(self, nats: float) -> frozenset[str]:
        """Those at most so far behind the truth."""
        near = (name for name, behind in self.behind.items() if -BETTER_NATS <= behind <= nats)
        return frozenset({self.effect, *near})

    def up_to(self, nats: float) -> frozenset[str]:
        """Return the class with rivals that fit better than the truth by up to `nats`."""
        return self.within(nats) | {name for name, behind in self.behind.items() if behind <= nats}

    @property
    def shows(self) -> bool:
        """True if the runs show at all that something is missing."""
        return self.gain_nats is None or self.gain_nats >= ALIAS_NATS


def alias_classes(truth: Truth, file: TwinFile, runs: Sequence[RecordedRun]) -> tuple[AliasClass, ...]:
    """Return the class of each hidden effect of a case, in the truth's
    order. Errors: DataError as of `batch_runs`
    """
    if all(item.name in _WITHOUT_A_COLUMN for item in truth.hidden):
        return tuple(AliasClass(item.name) for item in truth.hidden)
    data = batch_runs(runs, file.sample_s)
    mains_sd, curve = (truth.noise.get(key, 0.0) for key in ("heater_power_run_sd", "ua_curve_per_10_k"))
    whole = structure(_with(file, truth.hidden), data, mains_sd, curve)
    found = fit(whole, whole.start, _FIRST_NOISE, passes=1)
    whole = structure(whole.file, _without_outliers(whole, found), mains_sd, curve)
    found = fit(whole, found.scaled, found.noise, _TRUTH_PASSES)
    return tuple(_class(item, whole, found) for item in truth.hidden)


def _without_outliers(truth: Structure, found: LikelihoodFit) -> RunBatch:
    residual = truth.residual(found.scaled)
    usual = 1.4826 * np.median(np.abs(residual[truth.measured]))  # sd of a normal distribution
    temp = truth.data.temp.copy()
    temp[:, 1:][np.abs(residual) > OUTLIER_SD * usual] = np.nan
    return replace(truth.data, temp=temp)


def _class(hidden: HiddenEffect, truth: Structure, found: LikelihoodFit) -> AliasClass:
    if hidden.name in _WITHOUT_A_COLUMN:
        return AliasClass(hidden.name)
    nothing = _fit_near(truth.other(_others(truth, hidden.name)), {}, truth, found)
    gain = found.log_likelihood - nothing
    behind: dict[str, float] = {}
    if gain >= ALIAS_NATS:
        sifted = sieve(truth, found, hidden.name)
        for name in _rivals(hidden.name, truth.file, truth.data):
            own = sifted.start_of(name)
            if own is None:
                continue
            rival = truth.other({**_others(truth, hidden.name), name: unknown(name, truth.file)})
            reached = _fit_near(rival, dict(zip(_places_of(name), own, strict=True)), truth, found)
            nats = found.log_likelihood - reached + _price(name, hidden.name, truth)
            if nats <= KEPT_NATS and reached - nothing >= ALIAS_NATS:
                behind[name] = nats
    return AliasClass(hidden.name, behind, gain)


def _others(truth: Structure, hidden: str) -> dict[str, Mapping[str, Value]]:
    return {key: own for key, own in truth.file.effects.items() if key != hidden}


def _places_of(name: str) -> list[Place]:
    return [("effects", name, item.name) for item in EFFECTS[name].parameters]


def _fit_near(rival: Structure, own: Mapping[Place, float], truth: Structure, found: LikelihoodFit) -> float:
    """Log likelihood of a structure, begun at its own scaled parameters and the true fit of the others."""
    others = truth.values(found.scaled)
    begun = [
        own[item.place] if item.place in own else item.scale(others.get(item.place, item.start))
        for item in rival.unknowns
    ]
    once = fit(rival, np.array(begun), found.noise, passes=1)
    if found.log_likelihood - once.log_likelihood > SECOND_LOOK_NATS:
        return once.log_likelihood
    return max(once.log_likelihood, fit(rival, once.scaled, once.noise, passes=1).log_likelihood)


def _price(rival: str, hidden: str, truth: Structure) -> float:
    """Return the penalty of the rival's further parameters [nats]."""
    more = len(EFFECTS[rival].parameters) - len(EFFECTS[hidden].parameters)
    return max(0, more) * 0.5 * float(np.log(truth.measured.sum()))


def _rivals(hidden: str, file: TwinFile, data: RunBatch) -> Iterator[str]:
    """Effects that could stand in the place of a hidden one: not there, with their columns, and acting."""
    for name, effect in {**USUAL_EFFECTS, **FURTHER_EFFECTS}.items():
        missing = [column for column in effect.needs if column not in data.conditions]
        if name in file.effects or name in _WITHOUT_A_COLUMN or missing:
            continue
        if name in acting_effects([*(key for key in file.effects if key != hidden), name]):
            yield name


def _with(file: TwinFile, hidden: tuple[HiddenEffect, ...]) -> TwinFile:
    known = [item for item in hidden if item.name not in _WITHOUT_A_COLUMN]
    added = {item.name: unknown(item.name, file, item.parameters) for item in known}
    return replace(file, effects={**file.effects, **added})


def cached_classes(
    cache: Path, key: str, truth: Truth, file: TwinFile, runs: Sequence[RecordedRun]
) -> tuple[AliasClass, ...]:
    """Return the classes cached for this key, else compute them and write them to `cache`."""
    key = f"{METHOD_VERSION}:{key}"
    if cache.exists():
        document = json.loads(cache.read_text(encoding="utf-8"))
        if document["key"] == key:
            return tuple(AliasClass(**item) for item in document["classes"])
    begun_s = time.process_time()
    classes = alias_classes(truth, file, runs)
    document = {
        "key": key,
        "seconds": time.process_time() - begun_s,
        "classes": [asdict(item) for item in classes],
    }
    cache.parent.mkdir(parents=True, exist_ok=True)
    cache.write_text(json.dumps(document) + "\n", encoding="utf-8")
    return classes
