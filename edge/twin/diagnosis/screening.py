"""A quick look at every candidate beside a set: what it explains while the set's noise stays as it is.

The set's own values move in proportion only, so that nothing but what is added has to be sought.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

from edge.twin.diagnosis.candidates import Candidates, Names, Scored
from edge.twin.diagnosis.fitting import fit, gains_of, glance, slopes
from edge.twin.diagnosis.innovations import NoiseLevels
from edge.twin.diagnosis.progress import Progress
from edge.twin.diagnosis.side_by_side import SideBySide
from edge.twin.diagnosis.starts import settled, with_effect
from edge.twin.diagnosis.trial import Trial
from edge.twin.recorded import Recorded
from edge.twin.twin_file import TwinFile

FORMULAS = 2  # in one set: more of them can follow anything
FIRST_FEW = 6  # that are looked at closely
SCREENED, CLOSELY = 4, 8  # iterations

Key = tuple[Names, NoiseLevels]


class Candidate(NamedTuple):
    """Beside a set, with the set's noise: nats over the set, and its file, None for a formula."""

    name: str
    gain: float
    file: TwinFile | None


@dataclass(frozen=True, slots=True, eq=False)
class Screening:
    """Candidates beside sets, each set looked at once."""

    candidates: Candidates
    runs: Recorded
    progress: Progress
    shared: SideBySide = field(default_factory=SideBySide)
    _known: dict[Key, list[Candidate]] = field(default_factory=dict)
    _formulas: dict[Key, list[Candidate]] = field(default_factory=dict)
    _close: set[Key] = field(default_factory=set)

    def beside(self, item: Scored) -> list[Candidate]:
        """Every candidate beside a set, the most promising first."""
        key = _key(item)
        if key not in self._known:
            still = self._still(item)
            names = [name for name in self.candidates.names if name not in item.added]
            self.progress(f"{' + '.join(sorted(item.added)) or 'as given'}: {len(names)} candidates")
            self._known[key] = self._in_order([*self._effects(still, names), *self.formulas_beside(item)])
        return self._known[key]

    def closely_beside(self, item: Scored) -> list[Candidate]:
        """The same, its first few names as good as they get: a start may lie far from the top."""
        found, key = self.beside(item), _key(item)
        if key in self._close:
            return found
        first_few = [other for other in found if other.file is not None][:FIRST_FEW]
        still = self._still(item)
        trials = [replace(still, file=other.file) for other in first_few if other.file is not None]
        [base] = fit([replace(still, free=())], self.runs, CLOSELY)
        better = self.shared.map(partial(fit, runs=self.runs, iterations=CLOSELY), trials)
        of_name = {other.name: other for other in found} | {
            other.name: Candidate(other.name, fitted.log_likelihood - base.log_likelihood, fitted.file)
            for other, fitted in zip(first_few, better, strict=True)
        }
        self._known[key] = self._in_order(of_name.values())
        self._close.add(key)
        return self._known[key]

    def formulas_beside(self, item: Scored) -> list[Candidate]:
        """Formulas alone, as far as there is room for one more."""
        key, formulas = _key(item), self.candidates.formulas
        if len(item.added & formulas.keys()) >= FORMULAS:
            return []
        if key not in self._formulas:
            terms = [term for name, term in formulas.items() if name not in item.added]
            gains = gains_of(self._still(item), terms, self.runs)
            found = (Candidate(term.name, float(gain), None) for term, gain in zip(terms, gains, strict=True))
            self._formulas[key] = self._in_order(found)
        return self._formulas[key]

    def _in_order(self, found: Iterable[Candidate]) -> list[Candidate]:
        return sorted(found, key=lambda item: self.candidates.penalty(item.name) - item.gain)

    def _still(self, item: Scored) -> Trial:
        """A trial whose own values move in proportion."""
        base = item.fitted
        terms = (*base.trial.nuisances, *slopes(base, self.runs))
        return Trial(settled(base.file), base.trial.levels, terms)

    def _effects(self, still: Trial, names: Sequence[str]) -> list[Candidate]:
        """Each effect beside a trial that stands still; each start gets one step, the best of each more."""
        starts = [(name, file) for name in names for file in with_effect(still.file, name)]
        trials = [replace(still, file=file) for _, file in starts]
        first = self.shared.map(partial(glance, runs=self.runs), trials)
        best = _best([name for name, _ in starts], first)
        [base] = fit([replace(still, free=())], self.runs, SCREENED)
        again = self.shared.map(partial(fit, runs=self.runs, iterations=SCREENED), list(best.values()))
        return [
            Candidate(name, item.log_likelihood - base.log_likelihood, item.file)
            for name, item in zip(best, again, strict=True)
        ]


def _key(item: Scored) -> Key:
    return item.added, item.fitted.trial.levels


def _best(names: Sequence[str], found: Sequence[tuple[Trial, float]]) -> dict[str, Trial]:
    """The likeliest of each name."""
    best: dict[str, tuple[Trial, float]] = {}
    for name, (trial, nats) in zip(names, found, strict=True):
        if name not in best or nats > best[name][1]:
            best[name] = trial, nats
    return {name: trial for name, (trial, _) in best.items()}
