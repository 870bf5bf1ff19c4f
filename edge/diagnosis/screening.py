"""A quick look at every candidate beside a set: what it explains while the set's noise stays as it is.

The set's own values move in proportion only, so that nothing but what is added has to be sought.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from typing import NamedTuple

from edge.diagnosis.candidates import Candidates, Names, ScoredSet
from edge.diagnosis.fitting import fit, gains_of, glance, slopes
from edge.diagnosis.innovations import NoiseLevels
from edge.diagnosis.progress import Telling
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import Trial
from edge.diagnosis.unknowns import settle, with_effect
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile

FORMULAS = 2  # in one set: more of them can follow anything
FIRST_FEW = 6  # that are looked at closely
SCREENED, CLOSELY = 4, 8  # iterations

Key = tuple[Names, NoiseLevels]


class ScreenedCandidate(NamedTuple):
    """Beside a set, with the set's noise: nats over the set, and its file, None for a formula."""

    name: str
    gain: float
    file: TwinFile | None


@dataclass(frozen=True, slots=True, eq=False)
class Screening:
    """Candidates beside sets, each set looked at once."""

    candidates: Candidates
    runs: RunBatch
    progress: Telling
    pool: SideBySide = field(default_factory=SideBySide)
    _known: dict[Key, list[ScreenedCandidate]] = field(default_factory=dict)
    _formulas: dict[Key, list[ScreenedCandidate]] = field(default_factory=dict)
    _close: set[Key] = field(default_factory=set)

    def beside(self, item: ScoredSet) -> list[ScreenedCandidate]:
        """Every candidate beside a set, the most promising first."""
        self._look([item])
        return self._known[_key(item)]

    def closely_beside(self, items: Sequence[ScoredSet]) -> list[list[ScreenedCandidate]]:
        """Fit the first few candidates of each set fully, since a start may lie far from the maximum."""
        self._look(items)
        self._look_closely([item for item in items if _key(item) not in self._close])
        return [self._known[_key(item)] for item in items]

    def _look(self, items: Sequence[ScoredSet]) -> None:
        new = list({_key(item): item for item in items if _key(item) not in self._known}.values())
        if not new:
            return
        names = [[name for name in self.candidates.names if name not in item.added] for item in new]
        for item, own in zip(new, names, strict=True):
            self.progress(f"{' + '.join(sorted(item.added)) or 'as given'}: {len(own)} candidates")
        for item, found in zip(new, self._effects(new, names), strict=True):
            self._known[_key(item)] = self._in_order([*found, *self.formulas_beside(item)])

    def _look_closely(self, items: Sequence[ScoredSet]) -> None:
        stills = [self._still(item) for item in items]
        few = [
            [other for other in self._known[_key(item)] if other.file is not None][:FIRST_FEW]
            for item in items
        ]
        better = self._over(stills, few, CLOSELY)
        for item, found in zip(items, better, strict=True):
            of_name = {other.name: other for other in [*self._known[_key(item)], *found]}
            self._known[_key(item)] = self._in_order(of_name.values())
            self._close.add(_key(item))

    def formulas_beside(self, item: ScoredSet) -> list[ScreenedCandidate]:
        """Formulas alone, as far as there is room for one more."""
        key, formulas = _key(item), self.candidates.formulas
        if len(item.added & formulas.keys()) >= FORMULAS:
            return []
        if key not in self._formulas:
            terms = [term for name, term in formulas.items() if name not in item.added]
            gains = gains_of(self._still(item), terms, self.runs)
            found = (
                ScreenedCandidate(term.name, float(gain), None)
                for term, gain in zip(terms, gains, strict=True)
            )
            self._formulas[key] = self._in_order(found)
        return self._formulas[key]

    def _in_order(self, found: Iterable[ScreenedCandidate]) -> list[ScreenedCandidate]:
        return sorted(found, key=lambda item: self.candidates.penalty(item.name) - item.gain)

    def _still(self, item: ScoredSet) -> Trial:
        """Return a trial whose own values move in proportion."""
        base = item.fit
        terms = (*base.trial.nuisances, *slopes(base, self.runs))
        return Trial(settle(base.file), base.trial.levels, terms)

    def _effects(
        self, items: Sequence[ScoredSet], names: Sequence[Sequence[str]]
    ) -> list[list[ScreenedCandidate]]:
        """Each effect beside sets that stand still; each start gets one step, the best of each name more."""
        stills = [self._still(item) for item in items]
        starts = [
            (i, name, file)
            for i, own in enumerate(names)
            for name in own
            for file in with_effect(stills[i].file, name)
        ]
        trials = [replace(stills[i], file=file) for i, _, file in starts]
        first = self.pool.map(partial(glance, runs=self.runs), trials)
        best = _best([(i, name) for i, name, _ in starts], first)
        few = [
            [ScreenedCandidate(name, 0.0, trial.file) for (j, name), trial in best.items() if j == i]
            for i in range(len(items))
        ]
        return self._over(stills, few, SCREENED)

    def _over(
        self, stills: Sequence[Trial], few: Sequence[Sequence[ScreenedCandidate]], iterations: int
    ) -> list[list[ScreenedCandidate]]:
        """Candidates fitted beside what stands still, and what they bring over it."""
        bases = fit([replace(still, free=()) for still in stills], self.runs, iterations)
        trials = [
            replace(still, file=other.file)
            for still, own in zip(stills, few, strict=True)
            for other in own
            if other.file is not None
        ]
        fitted = iter(self.pool.map(partial(fit, runs=self.runs, iterations=iterations), trials))
        return [
            [
                ScreenedCandidate(other.name, item.log_likelihood - base.log_likelihood, item.file)
                for other, item in zip(own, islice(fitted, len(own)), strict=True)
            ]
            for base, own in zip(bases, few, strict=True)
        ]


def _key(item: ScoredSet) -> Key:
    return item.added, item.fit.trial.levels


def _best(
    names: Sequence[tuple[int, str]], found: Sequence[tuple[Trial, float]]
) -> dict[tuple[int, str], Trial]:
    """Return the likeliest trial of each name for each set."""
    best: dict[tuple[int, str], tuple[Trial, float]] = {}
    for name, (trial, nats) in zip(names, found, strict=True):
        if name not in best or nats > best[name][1]:
            best[name] = trial, nats
    return {name: trial for name, (trial, _) in best.items()}
