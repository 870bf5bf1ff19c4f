"""From sets of effects to what is said: the names that left-out rows prove, and how sure each is."""

import math
from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.depends import Dependence, dependences
from edge.diagnosis.diagnosis_document import FOUND, VerdictKind
from edge.diagnosis.twin_choice import (
    CLEARLY,
    EXPLAINED,
    LAGS,
    MATTERS,
    PAYS,
    Names,
    TriedTwin,
    TwinChoice,
    features,
    is_slow,
    log_odds,
)
from edge.diagnosis.twin_fit import FittedTwin
from edge.diagnosis.unknowns import UnknownValue
from edge.twin.effects.effect import Offer
from edge.twin.effects.library import EFFECTS
from edge.twin.value import SDS_95, Value

Floats = NDArray[np.float64]
LIKELY = 0.5  # a name that is less likely only helps to predict
MOST_SURE = 0.99  # no more can be learnt from so many cases
SHORTEST_ROWS = 0.5  # of a lag that rows can show
UNEXPLAINED_FROM = 3.0  # times a reading's noise: something is missing that has no name
ALIKE = 1.1  # times the error over fitted rows, for another name to explain them as well
LARGE = 0.5  # a logarithm: so much less is missed with what is no name, for that to be what is missing
# Log odds by what the twin misses over a reading's noise, and for a lag or a body.
UNEXPLAINED, SLOW = -0.1, 0.6


@dataclass(frozen=True, slots=True, eq=False)
class NameEvidence:
    """Evidence of rows for a name that is in the chosen twin.

    more, error : how much more left-out rows are missed without it, a logarithm, and its standard error
    fitted : the same of rows that were fitted; unexplained : of what the twin misses over a reading's noise
    blocks : of left-out rows
    is_slow : a lag or a body that stores heat, which every box has
    """

    more: float
    error: float
    fitted: float
    unexplained: float
    blocks: int
    is_slow: bool

    @property
    def features(self) -> tuple[float, ...]:
        """Numbers that tell how likely a name is right."""
        return (*features(self.more, self.error, self.fitted), self.unexplained, float(self.is_slow))

    @property
    def probability(self) -> float:
        """That the name, or one that a log can't tell from it, is right."""
        odds = log_odds(self.more, self.error, self.fitted)
        odds += UNEXPLAINED * self.unexplained + SLOW * self.is_slow
        return min(MOST_SURE, 1.0 / (1.0 + math.exp(-odds)))


@dataclass(frozen=True, slots=True, eq=False)
class MissingEffect:
    """A missing effect.

    alternatives : effects that predict as well in its place, and the log odds of each against it [nat]
    log_odds : against the twin without it [nat]
    """

    name: str
    alternatives: Mapping[str, float]
    log_odds: float
    probability: float
    parameters: Mapping[str, Value]


@dataclass(frozen=True, slots=True)
class DoubtfulName:
    """An effect that helps to predict and whose name does not stand, with sentences why."""

    name: str
    against: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisVerdict:
    """kind : of diagnosis.json; effects, likeliest first; handed : the twin that is handed over

    depends : what an unknown effect depends on, strongest first
    """

    kind: VerdictKind
    effects: tuple[MissingEffect, ...]
    doubtful: tuple[DoubtfulName, ...]
    depends: tuple[Dependence, ...]
    handed: TriedTwin

    @property
    def provisional(self) -> tuple[str, ...]:
        """Effects of the twin that is handed over whose names do not stand."""
        return tuple(sorted(self.handed.added - {item.name for item in self.effects}))

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Signals that an unknown effect depends on."""
        if self.kind != "unknown":
            return ()
        return tuple(dict.fromkeys(name for item in self.depends for name in item.signals)) or ("none",)


def judge(
    choice: TwinChoice, names: Names, added: Names, found: AbstractSet[str] = frozenset()
) -> DiagnosisVerdict:
    """Say which effects of a chosen set are names.

    added : those of the twin that is handed over
    found : those whose input nobody recorded, but was found in the runs: events, and no names
    """
    handed = choice.tried[added]
    effects, doubtful, unnamed = [], [], 0.0
    for name in names:
        evidence = evidence_of(choice, names, name)
        others = alternatives(choice, names, name)
        pair = choice.tried[added], choice.tried[added - {name}]
        against = _against(name, *pair, evidence, choice.file.sample_s)
        if is_name(name) and choice.is_too_slow(added, name):
            against.append("it is slower than these runs can show")
        if name in found:
            against.append(FOUND)
        elif not is_name(name):
            unnamed = max(unnamed, evidence.more)
        elif common := [other for other in others if not is_name(other)]:
            against.append(f"it can't be told from {common[0]}, which is in every warm box")
            unnamed = max(unnamed, evidence.more)
        probability = evidence.probability / (1.0 + (_rivals(name, others) if is_name(name) else 0.0))
        if not against and probability < LIKELY:
            against.append(f"it can't be told from {' or '.join(others)}")
            unnamed = max(unnamed, evidence.more)
        if against:
            doubtful.append(DoubtfulName(name, tuple(against)))
            continue
        effects.append(
            MissingEffect(
                name,
                others,
                evidence.more * evidence.blocks,
                probability,
                values_of(choice.tried[names].fit, name),
            )
        )
    effects.sort(key=lambda item: (-round(item.probability, 2), -item.log_odds))
    missed = choice.tried[names].fit.rmse_k / choice.noise_k
    depends: tuple[Dependence, ...] = ()
    kind: VerdictKind = "named" if effects else "nothing_missing"
    if not effects and (missed > EXPLAINED or unnamed > LARGE):
        depends = dependences(choice, choice.tried[names - {item.name for item in doubtful}])
        if depends or missed > UNEXPLAINED_FROM or unnamed > LARGE:
            kind = "unknown"
    return DiagnosisVerdict(kind, tuple(effects), tuple(doubtful), depends, handed)


def evidence_of(choice: TwinChoice, names: Names, name: str) -> NameEvidence:
    """Compare a twin with the same without one of its effects."""
    own, less = choice.tried[names], choice.tried[names - {name}]
    more, error = less.behind(own, choice.noise_k)
    return NameEvidence(
        more,
        error,
        math.log(less.fit.rmse_k / own.fit.rmse_k),
        max(0.0, math.log(own.fit.rmse_k / choice.noise_k)),
        len(own.left_out),
        is_slow(name),
    )


def _rivals(name: str, others: Mapping[str, float]) -> float:
    """Return how likely other effects are beside a name that is 1. others : their log odds against it

    Those of its kind do not count: late or stored heat, air that a fan moves, what the same runs would hide.
    """
    return sum(math.exp(min(odds, 0.0)) for key, odds in others.items() if not _kinds(name) & _kinds(key))


def _kinds(name: str) -> set[str]:
    effect = EFFECTS[name]
    late = {"late"} if is_slow(name) or effect.common else set[str]()
    return {item.runs.name for item in effect.hidden_by} | late | ({"flow"} if effect.by_flow else set())


def is_name(name: str) -> bool:
    """Return whether a term of a twin names a cause."""
    return name in EFFECTS and EFFECTS[name].offer is Offer.CANDIDATE


def _against(
    name: str, with_it: TriedTwin, without: TriedTwin, evidence: NameEvidence, step_s: float
) -> list[str]:
    if not is_name(name):
        return ["it is no name for a cause"]
    found = []
    for item, x in zip(with_it.fit.free, with_it.fit.x, strict=True):
        if item.place[:2] != ("effects", name):
            continue
        kind = EFFECTS[name].parameter(item.place[2]).kind
        if kind in LAGS and item.value(x) < SHORTEST_ROWS * step_s:
            found.append(
                f"{item.place[2]} is {item.value(x):.3g} s, and rows of {step_s:g} s can't show that"
            )
    if evidence.more <= 0.0:
        found.append("left-out rows are forecast no worse without it")
    if without.fit.rmse_k < PAYS * with_it.fit.rmse_k:
        found.append("it is needless beside what else the twin has")
    if evidence.probability < LIKELY:
        found.append(f"it is right in {100.0 * evidence.probability:.0f} of 100 such cases")
    return found


def alternatives(choice: TwinChoice, names: Names, name: str) -> dict[str, float]:
    """Return effects that predict left-out rows as well in the place of one, likeliest first."""
    own, found = choice.tried[names], {}
    for key, item in choice.tried.items():
        if len(key) == len(names) and names - key == {name}:
            (other,) = key - names
            if other not in EFFECTS or not choice.pays(key) or choice.is_too_slow(key, other):
                continue
            more, error = item.behind(own, choice.noise_k)
            fits_k = ALIKE * max(own.fit.rmse_k, choice.noise_k)
            if more <= max(CLEARLY * error, MATTERS) and item.fit.rmse_k <= fits_k:
                found[other] = -more * len(own.left_out)
    return dict(sorted(found.items(), key=lambda pair: -pair[1]))


def values_of(fit: FittedTwin, name: str) -> dict[str, Value]:
    """Return the values of an effect with 95 % intervals."""
    return {
        item.place[2]: interval(item, float(x), float(variance))
        for item, x, variance in zip(fit.free, fit.x, np.diag(fit.covariance), strict=True)
        if item.place[:2] == ("effects", name)
    }


def interval(item: UnknownValue, x: float, variance: float) -> Value:
    """Return a value with its 95 % interval."""
    sd = float(np.sqrt(max(variance, 0.0)))
    return Value(item.value(x), low=item.value(x - SDS_95 * sd), high=item.value(x + SDS_95 * sd))
