"""Which sets of effects are still open beside the best one, and what is to be told from what."""

from dataclasses import dataclass

import numpy as np

from edge.diagnosis.diagnose import Diagnosis
from edge.diagnosis.twin_fit import FittedTwin

RIVAL_NATS = 3.0  # log odds that leave a question open
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
    names = frozenset(effect.name for effect in found.verdict.effects)
    near = [
        (effect.name, other, log_odds)
        for effect in found.verdict.effects
        for other, log_odds in effect.alternatives.items()
        if names - {effect.name} | {other} in found.choice.tried
    ]
    near = sorted(near, key=lambda entry: -entry[2])[:MOST_RIVALS]
    if not near or names not in found.choice.tried:
        return None
    models, pairs = [found.choice.tried[names].fit], []
    for effect in found.verdict.effects:
        members = [(0, effect.name, 0.0)]
        for place, name, log_odds in near:
            if place == effect.name:
                members.append((len(models), name, log_odds))
                models.append(found.choice.tried[names - {place} | {name}].fit)
        if len(members) > 1:
            pairs += _pairs(effect.name, members)
    return Rivals(tuple(models), tuple(pairs))


def _pairs(place: str, members: list[tuple[int, str, float]]) -> list[RivalPair]:
    odds = np.exp(np.array([log_odds for _, _, log_odds in members]))
    shares = odds / odds.sum()
    return [
        RivalPair(i, j, name, other, place, float(share), float(share) / (len(members) - 1))
        for (i, name, _), share in zip(members, shares, strict=True)
        for j, other, _ in members
        if i != j
    ]
