"""The verdict of the search in the terms of diagnosis.json, with the probability of each name.

The probability is a logistic regression on the evidence of left-out rows for the name. A likelihood alone is
too sure: it knows its own model, not the alternatives outside it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from edge.diagnosis.candidates import ScoredSet
from edge.diagnosis.diagnosis_document import VerdictKind
from edge.diagnosis.formulas import PREFIX, FormulaShape
from edge.diagnosis.noise_levels import unexplained_heat
from edge.diagnosis.search import RIVAL_NATS, Search
from edge.diagnosis.trial import FittedTwin
from edge.diagnosis.unknowns import UnknownValue
from edge.twin.value import SDS_95, Value

# As `python -m bench.calibrate` at commit 02ed168c printed them for 158 names of simulated cases and 5 of
# measured logs, which count thrice: intercept, and slopes of `evidence`.
INTERCEPT, NATS, RATIO = -2.86, 1.06, 1.03
MOST_SURE = 0.99  # no more can be learnt from so many cases
LIKELY = 0.4  # below it a name is only listed


def evidence(tempered_nats: float, with_k: float, without_k: float) -> tuple[float, float]:
    """Logarithms: nats, errors that go together counted once; the error without a name over that with it."""
    return math.log(max(tempered_nats, 1.0)), math.log(without_k / max(with_k, 1e-9))


def probability(numbers: tuple[float, float]) -> float:
    """Return the probability that a name, or one that cannot be told from
    it, is right, from its `evidence`.
    """
    odds = INTERCEPT + NATS * numbers[0] + RATIO * numbers[1]
    return min(MOST_SURE, 1.0 / (1.0 + math.exp(-odds)))


# In development cases (bench/hidden_effects at commit 02ed168c) right names left 0.37 or less; 0.50 and 0.70
# were left by wrong ones, where the declared noise could not be made to cover what they do not explain.
REFUTED = 0.45
NOTHING = "none"  # that an unknown effect depends on


@dataclass(frozen=True, slots=True)
class MissingEffect:
    """A missing effect.

    alternatives : effects that explain the runs as well in its place, and by how many nats more or less
    log_odds : against the best set without it [nat]
    """

    name: str
    alternatives: Mapping[str, float]
    log_odds: float
    parameters: Mapping[str, Value]
    at_bound: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Coefficient:
    """The coefficient of a formula's term, with its 95 % interval."""

    text: str
    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisVerdict:
    """kind : of diagnosis.json; effects, most important first; final : the set that the gap is shown for"""

    kind: VerdictKind
    effects: tuple[MissingEffect, ...]
    depends_on: tuple[str, ...]
    formula: tuple[Coefficient, ...]
    final: ScoredSet


def verdict(search: Search, shapes: Mapping[str, FormulaShape]) -> DiagnosisVerdict:
    """Return the best set as a verdict."""
    best = search.missing()
    if best.added and _is_refuted(best.fit):
        best = search.formulas_alone()
    worth = search.sets.worth(best, sorted(best.added))
    order = sorted(best.added, key=lambda name: -worth[name])
    formula = [name for name in order if name.startswith(PREFIX)]
    if formula and order[0] == formula[0]:
        return DiagnosisVerdict(
            "unknown", (), _dependences(formula, shapes), _coefficients(best, formula, shapes), best
        )
    if len(formula) < len(order):
        return DiagnosisVerdict("named", read(search, best), (), _coefficients(best, formula, shapes), best)
    if _is_refuted(best.fit) or unexplained_heat(best.fit, search.file, search.runs):
        return DiagnosisVerdict("unknown", (), (NOTHING,), (), best)
    return DiagnosisVerdict("nothing_missing", (), (), (), best)


def read(search: Search, best: ScoredSet) -> tuple[MissingEffect, ...]:
    """Return the names of a set with their rivals, the strongest first."""
    worth = search.sets.worth(best, sorted(best.added))
    order = sorted(best.added, key=lambda name: -worth[name])
    named = [name for name in order if not name.startswith(PREFIX)]
    # Values as the twin has them that is handed on: it has no formula, and one beside them bends them.
    alone = reduce(search.sets.without, [name for name in order if name.startswith(PREFIX)], best)
    rivals = search.rivals(best, named)
    return tuple(_missing_effect(rivals[name], best, alone, name, worth[name]) for name in named)


def unnamed_verdict(search: Search, shapes: Mapping[str, FormulaShape]) -> DiagnosisVerdict:
    """Return the verdict without a standing name: the best formulas, or none."""
    best = search.formulas_alone()
    formula = sorted(best.added)
    depends_on = _dependences(formula, shapes) or (NOTHING,)
    return DiagnosisVerdict("unknown", (), depends_on, _coefficients(best, formula, shapes), best)


def _is_refuted(fitted: FittedTwin) -> bool:
    """Return whether the errors still depend on those before: a gap that shrank under a wrong name.

    Lag-1 autocorrelation of the innovations over all runs, which is 0 for a right twin with its right noise
    """
    seen = fitted.innovations != 0.0
    both = seen[:, 1:] & seen[:, :-1]
    pairs = (fitted.innovations[:, 1:] * fitted.innovations[:, :-1])[both]
    return bool(pairs.sum() > REFUTED * (fitted.innovations[:, 1:] ** 2)[both].sum())


def _dependences(formula: Sequence[str], shapes: Mapping[str, FormulaShape]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for key in formula for name in shapes[key].depends_on))


def _coefficients(
    best: ScoredSet, formula: Sequence[str], shapes: Mapping[str, FormulaShape]
) -> tuple[Coefficient, ...]:
    terms = [term.name for term in best.fit.trial.nuisances]
    found = []
    for name in formula:
        place = terms.index(name)
        size, sd = float(best.fit.sizes[place]), float(best.fit.size_sds[place])
        shape = shapes[name]
        found.append(Coefficient(shape.text, size, size - SDS_95 * sd, size + SDS_95 * sd, shape.unit))
    return tuple(found)


def _missing_effect(
    near: Sequence[ScoredSet], best: ScoredSet, alone: ScoredSet, name: str, worth: float
) -> MissingEffect:
    rivals = {}
    for item in near:
        (other,) = item.added - (best.added - {name})
        if item.likelihood >= best.likelihood - RIVAL_NATS and not other.startswith(PREFIX):
            rivals[other] = item.likelihood - best.likelihood
    values, bound = intervals(alone.fit, name)
    ordered = dict(sorted(rivals.items(), key=lambda pair: -pair[1]))
    return MissingEffect(name, ordered, float(worth), values, bound)


def intervals(fitted: FittedTwin, name: str) -> tuple[dict[str, Value], tuple[str, ...]]:
    """Values of an effect with 95 % intervals, cut at their bounds, and those that ended at one."""
    values, bound = {}, []
    for i, item in enumerate(fitted.free):
        if item.place[:2] == ("effects", name):
            values[item.place[2]] = interval(
                item, float(fitted.coordinates[i]), float(fitted.covariance[i, i])
            )
            if item.is_at_bound(float(fitted.coordinates[i])):
                bound.append(item.place[2])
    return values, tuple(bound)


def interval(item: UnknownValue, x: float, variance: float) -> Value:
    """Return a value with its 95 % interval."""
    sd = float(np.sqrt(max(variance, 0.0)))
    return Value(item.value(x), low=item.value(x - SDS_95 * sd), high=item.value(x + SDS_95 * sd))
