"""Which sets of effects are still open beside the best one, and what is to be told from what."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edge.diagnosis.candidates import ScoredSet
from edge.diagnosis.diagnose import Diagnosis
from edge.diagnosis.formulas import PREFIX
from edge.diagnosis.trial import FittedTwin

OPEN_NATS = 10.0  # behind the best, within which a rival may still be the truth
MOST_RIVALS = 5  # the nearest ones


@dataclass(frozen=True, slots=True)
class RivalPair:
    """`true` explains the new run, `other` is refitted to it: places among the models, and their names.

    place : the effect of the best set in whose place they stand
    share : how likely it is, by the runs so far, that the first is the true one of those in its place
    weight : of the pair among all, in proportion
    """

    true: int
    other: int
    true_name: str
    other_name: str
    place: str
    share: float
    weight: float


@dataclass(frozen=True, slots=True)
class Rivals:
    """Fitted sets, the best one first, and the pairs in which they compete for an effect's place."""

    models: tuple[FittedTwin, ...]
    pairs: tuple[RivalPair, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that are to be told apart, each once."""
        return tuple(dict.fromkeys(name for pair in self.pairs for name in (pair.true_name, pair.other_name)))


def open_rivals(found: Diagnosis) -> Rivals | None:
    """Return the rivals of all named effects, None where no question is open."""
    best = found.verdict.final
    named = [effect.name for effect in found.verdict.effects]
    near = [
        (name, other, item)
        for name, items in found.search.rivals(best, named).items()
        for other, item in _near(items, best, name)
    ]
    near = sorted(near, key=lambda entry: -entry[2].likelihood)[:MOST_RIVALS]
    if not near:
        return None
    models, pairs = [best.fit], []
    for effect in found.verdict.effects:
        members = [(0, effect.name, best)]
        for place, name, item in near:
            if place == effect.name:
                members.append((len(models), name, item))
                models.append(item.fit)
        if len(members) > 1:
            pairs += _pairs(effect.name, members)
    return Rivals(tuple(models), tuple(pairs))


def _near(items: Sequence[ScoredSet], best: ScoredSet, name: str) -> list[tuple[str, ScoredSet]]:
    """Named effects in the place of `name`."""
    near = []
    for item in items:
        (other,) = item.added - (best.added - {name})
        if item.likelihood >= best.likelihood - OPEN_NATS and not other.startswith(PREFIX):
            near.append((other, item))
    return near


def _pairs(place: str, members: Sequence[tuple[int, str, ScoredSet]]) -> list[RivalPair]:
    likelihoods = np.array([item.likelihood for _, _, item in members])
    odds = np.exp(likelihoods - likelihoods.max())
    shares = odds / odds.sum()
    return [
        RivalPair(i, j, name, other, place, float(share), float(share) / (len(members) - 1))
        for (i, name, _), share in zip(members, shares, strict=True)
        for j, other, _ in members
        if i != j
    ]
