"""Which effects are missing: a search over sets of named effects, each fitted by maximum likelihood.

Sets are compared by their likelihood less what their effects cost (`edge.diagnosis.candidates`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

from edge.diagnosis.candidates import Candidates, Names, ScoredSet
from edge.diagnosis.progress import Telling
from edge.diagnosis.screening import FORMULAS, ScreenedCandidate, Screening
from edge.diagnosis.sets import AGAIN, SEVERAL, Sets, best_of
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import SizedTerm
from edge.twin.effects.library import EFFECTS
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile

REFINED = 6  # candidates of a round that get noise levels of their own
LARGEST_SET = 10
BEHIND = 0.5  # share of the first one's gain by which another may be behind, to be looked at again
LARGE_NATS = 200.0  # a gain of which a screening misses much, as other values can't follow
ROUGHLY = 4  # names that are looked at then, however far they seem
MIMICS = 3  # names that may be tried on what a formula explains better
EXCHANGE_NATS = 0.5
EXCHANGED = 2  # others that are tried in the place of a member
MOST_EXCHANGED = 4  # members of a set that this is done for
MERGED_PAIRS, MERGED_INTO = 2, 2  # pairs that one effect may stand for, the least ones; how many are tried
MARGIN = 3.0  # nats beyond the penalty, as the noise is not quite what the model says
NEXT_MARGIN = 8.0  # the same beside an effect: what the first leaves a little wrong invites more
HOPELESS_NATS = -4.0  # after the penalty: noise levels of its own won't bring a candidate above 0
RIVAL_NATS = 3.0  # a set as likely as the best within this is its rival
WORTH_A_LOOK = 12.0  # nats within which a screened rival is fitted with noise levels of its own


@dataclass(frozen=True, slots=True)
class TriedCandidate:
    """A candidate in a round."""

    name: str
    gain_nats: float  # over the set that it was added to
    score_gain: float  # after the penalty


@dataclass(frozen=True, slots=True)
class Round:
    """One more effect beside a set."""

    beside: Names
    candidates: tuple[TriedCandidate, ...]


@dataclass(slots=True, eq=False)
class Search:
    """Over one lot of runs: rounds as they were tried."""

    file: TwinFile
    runs: RunBatch
    progress: Telling
    nuisances: tuple[SizedTerm, ...] = ()
    formulas: Mapping[str, SizedTerm] = field(default_factory=dict)
    doors: int = 0
    rounds: list[Round] = field(default_factory=list)
    pool: SideBySide = field(default_factory=SideBySide)
    candidates: Candidates = field(init=False)
    screening: Screening = field(init=False)
    sets: Sets = field(init=False)

    def __post_init__(self) -> None:
        self.candidates = Candidates(self.file, self.runs, self.formulas, self.doors)
        self.screening = Screening(self.candidates, self.runs, self.progress, self.pool)
        self.sets = Sets(self.candidates, self.progress, self.nuisances, self.pool)

    def penalty(self, name: str) -> float:
        """Return the penalty for naming an effect or a formula [nats]."""
        return self.candidates.penalty(name)

    def missing(self) -> ScoredSet:
        """Return the best set: of names, of formulas, or of names with formulas for their remainder.

        Names are sought by themselves first, as a formula can stand for two of them and so end the search.
        """
        vague = self.formulas_alone()
        named = self._names(vague.score)
        both = self._prune(self._extend(named, 1))
        return max((named, both, vague), key=lambda item: item.score)

    def formulas_alone(self) -> ScoredSet:
        """Return the best set of formulas alone, the twin as given without any."""
        return self._extend(self.sets.base(), FORMULAS)

    def _names(self, rival: float) -> ScoredSet:
        """Names alone: grown one by one, pruned, and with each member exchanged.

        rival : what formulas are worth; a set of several names that is worth less follows what has none
        """
        best, seen = self.sets.base(), set[Names]()
        while len(best.added) < LARGEST_SET and best.added not in seen:
            if len(best.added) >= MIMICS and best.score < rival:
                break
            seen.add(best.added)
            best = self._prune(self._next(best))
        return best

    def _next(self, best: ScoredSet) -> ScoredSet:
        """Return a better set: a body split, one more effect or one exchanged; `best` if none is better."""
        apart = self._apart(best)
        if apart is not None:
            return apart
        grown = best_of(self._grow(best))
        margin = NEXT_MARGIN if best.added else MARGIN
        if grown and grown.score >= best.score + margin:
            return grown
        exchanged = self._exchange(best)
        return exchanged if exchanged is not best else self._merge(best)

    def _extend(self, item: ScoredSet, most: int) -> ScoredSet:
        """Return a set with up to `most` formulas, each only if it is worth its penalty."""
        for _ in range(most):
            found = self.screening.formulas_beside(item)
            grown = best_of(self._looked_at(item, self._promising(found)))
            if grown is None or grown.score < item.score + MARGIN:
                break
            item = grown
        return item

    def _apart(self, best: ScoredSet) -> ScoredSet | None:
        """Return the set with a body split that stood for two, where that explains more."""
        wanted = {}
        for name in sorted(best.added & EFFECTS.keys()):
            for parts in EFFECTS[name].taken_apart:
                key = best.added - {name} | set(parts)
                if len(key) > len(best.added) and key - best.added <= set(self.candidates.names):
                    wanted[key] = self.sets.as_usual(best, key)
        found = best_of(self.sets.fit(wanted))
        if found is None:
            return None
        margin = NEXT_MARGIN if found.added > best.added else 0.0
        return found if found.score > best.score + margin else None

    def _grow(self, beside: ScoredSet) -> list[ScoredSet]:
        """Return sets with one more effect, the most promising ones."""
        screened = self.screening.beside(beside)
        self.rounds.append(self._round(beside, screened))
        return self._looked_at(beside, self._promising([item for item in screened if item.file is not None]))

    def _looked_at(self, beside: ScoredSet, found: Sequence[ScreenedCandidate]) -> list[ScoredSet]:
        """Candidates of a screening with noise of their own."""
        wanted = {beside.added | {item.name}: self.sets.thaw(beside, item) for item in found}
        return self.sets.fit(wanted)

    def _exchange(self, item: ScoredSet) -> ScoredSet:
        """Return the set with one member exchanged for a better one, if there is one."""
        names = sorted(item.added)
        if len(names) > MOST_EXCHANGED:
            names = sorted(names, key=self.sets.worth(item, names).__getitem__)[:MOST_EXCHANGED]
        found = self.rivals(item, names, EXCHANGED)
        return self._better([other for own in found.values() for other in own], item)

    def _merge(self, item: ScoredSet) -> ScoredSet:
        """Return the set with two members exchanged for one that explains both, if there is one."""
        names = sorted(item.added & EFFECTS.keys())
        if len(item.added) < SEVERAL or len(names) < 2:
            return item
        worth = self.sets.worth(item, names)
        pairs = sorted(combinations(names, 2), key=lambda pair: worth[pair[0]] + worth[pair[1]])
        besides = self.sets.as_they_are(item, pairs[:MERGED_PAIRS])
        places = [
            (beside, [other for other in screened if other.file and other.name not in item.added])
            for beside, screened in zip(besides, self.screening.closely_beside(besides), strict=True)
        ]
        found = self._in_place(item, [(beside, own[:MERGED_INTO]) for beside, own in places])
        return self._better([other for own in found for other in own], item)

    def _better(self, found: Sequence[ScoredSet], item: ScoredSet) -> ScoredSet:
        best = best_of(found)
        return item if best is None or best.score <= item.score + EXCHANGE_NATS else best

    def rivals(
        self, item: ScoredSet, names: Sequence[str], most: int = REFINED
    ) -> dict[str, list[ScoredSet]]:
        """For each of some members the sets in which another candidate stands in its place and comes near."""
        besides = self.sets.as_they_are(item, [(name,) for name in names])
        places = []
        for name, beside, screened in zip(
            names, besides, self.screening.closely_beside(besides), strict=True
        ):
            near = self._near(item, name, beside, screened)
            lent = replace(
                beside.fit, file=self.sets.shorten(item, name).file
            )  # values that a rival lives with too
            places.append((replace(beside, fit=lent), near[:most]))
        return dict(zip(names, self._in_place(item, places), strict=True))

    def _near(
        self, item: ScoredSet, name: str, beside: ScoredSet, screened: Sequence[ScreenedCandidate]
    ) -> list[ScreenedCandidate]:
        """Candidates that may explain as much as a member, at the noise of the set."""
        own = {found.name: found.gain for found in screened}.get(name, item.likelihood - beside.likelihood)
        others = [found for found in screened if found.name not in item.added]
        return [
            found
            for i, found in enumerate(others)
            if found.gain >= own - WORTH_A_LOOK + min(self.penalty(found.name) - self.penalty(name), 0.0)
            or (i < ROUGHLY and own > LARGE_NATS)
        ]

    def _in_place(
        self, item: ScoredSet, places: Sequence[tuple[ScoredSet, Sequence[ScreenedCandidate]]]
    ) -> list[list[ScoredSet]]:
        """Return the rest of a set with candidates in the place of the removed
        members. Noise starts from the set's own.
        """
        levels = item.fit.trial.levels
        trials = [
            {
                beside.added | {other.name}: replace(self.sets.thaw(beside, other), levels=levels)
                for other in found
            }
            for beside, found in places
        ]
        every = {key: trial for own in trials for key, trial in own.items()}
        fitted = dict(zip(every, self.sets.fit(every, AGAIN * len(places)), strict=True))
        return [[fitted[key] for key in own] for own in trials]

    def _promising(self, screened: Sequence[ScreenedCandidate]) -> Sequence[ScreenedCandidate]:
        """Return the first candidate and those close behind it, if they explain anything."""
        worth = [item.gain - self.penalty(item.name) for item in screened]
        if not worth:
            return []
        least = max(worth[0] - max(WORTH_A_LOOK, BEHIND * abs(worth[0])), HOPELESS_NATS)
        near = [item for item, own in zip(screened, worth, strict=True) if own >= least]
        return near[:REFINED] or screened[:1]

    def _round(self, beside: ScoredSet, screened: Sequence[ScreenedCandidate]) -> Round:
        tried = (
            TriedCandidate(item.name, item.gain, item.gain - self.penalty(item.name)) for item in screened
        )
        return Round(beside.added, tuple(tried))

    def _prune(self, item: ScoredSet) -> ScoredSet:
        """Return the set without effects that the others make needless."""
        while len(item.added) > 1:
            least = best_of(self.sets.less(item, sorted(item.added)))
            if least is None or least.score < item.score - NEXT_MARGIN:
                break
            item = least
        return item
