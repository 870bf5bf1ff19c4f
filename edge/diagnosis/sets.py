"""Fitted sets of effects, each refitted with noise levels of its own and saved as good as it was ever
found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from edge.diagnosis.candidates import Candidates, Names, ScoredSet
from edge.diagnosis.fitting import fit
from edge.diagnosis.noise_levels import FIRST_FACTOR, NEAR_FACTOR, find_levels, first_levels, level_prior
from edge.diagnosis.progress import Telling
from edge.diagnosis.screening import SCREENED, ScreenedCandidate
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import FittedTwin, SizedTerm, Trial
from edge.diagnosis.unknowns import unknowns, with_usual
from edge.twin.effects.library import EFFECTS
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

REFITTED, AFRESH = 3, 8  # iterations, from where a set was found and from the beginning
AGAIN = 2  # sets of a round that may begin again
LOUD = 3.0  # times the usual heat noise: no twin that lacks nothing has that much
SEVERAL = 3  # effects, beside which another one may change what the first ones were taken for


def refine(
    trials: Sequence[Trial],
    given: TwinFile,
    runs: RunBatch,
    again: int = AGAIN,
    shared: SideBySide | None = None,
) -> list[FittedTwin]:
    """Return the likelier fit of each trial, in the order given.

    given : the twin as it was before anything was added; again : how many, the best, may begin again
    """
    shared = shared or SideBySide()
    found = shared.map(partial(_level, given=given, runs=runs, first=REFITTED), trials)
    doubtful = [i for i, item in enumerate(found) if again and _doubtful(item, given, runs)]
    best = sorted(doubtful, key=lambda i: -_worth(found[i], given, runs))[:again]
    if best:
        fresh = [begin(trials[i], given, runs) for i in best]
        others = shared.map(partial(_level, given=given, runs=runs, first=AFRESH), fresh)
        for i, other in zip(best, others, strict=True):
            if likelihood(other, given) > likelihood(found[i], given):
                found[i] = other
    return found


def likelihood(found: FittedTwin, given: TwinFile) -> float:
    """In nats, the prior of its noise levels included."""
    return found.log_likelihood + level_prior(found.trial.levels, given)


def _level(trials: Sequence[Trial], given: TwinFile, runs: RunBatch, first: int) -> list[FittedTwin]:
    """Fitted, and then twice with better noise. first : iterations before"""
    found = fit(trials, runs, first)
    for factor in (FIRST_FACTOR, NEAR_FACTOR):
        found = fit(find_levels(found, given, runs, factor), runs, REFITTED)
    return found


def _worth(found: FittedTwin, given: TwinFile, runs: RunBatch) -> float:
    """Likelihood less what its values may explain by chance (BIC) [nats]."""
    rows = runs.measured.sum()
    return likelihood(found, given) - 0.5 * len(found.free) * float(np.log(rows))


def _doubtful(found: FittedTwin, given: TwinFile, runs: RunBatch) -> bool:
    added = found.file.effects.keys() - given.effects.keys()
    usual = first_levels(given, runs).heat_w
    return len(added) >= SEVERAL or found.trial.levels.heat_w > LOUD * usual


def begin(trial: Trial, given: TwinFile, runs: RunBatch) -> Trial:
    """With its free values where a fit begins, and the noise that is usual."""
    known = given.values()
    starts: dict[Place, Value] = {}
    for item in trial.free or ():
        if item.place in known:
            starts[item.place] = known[item.place]
        else:
            starts[item.place] = Value(given.usual(item.place).start, fit=True)
    return replace(trial, file=trial.file.with_values(starts), levels=first_levels(given, runs))


def best_of(sets: Sequence[ScoredSet]) -> ScoredSet | None:
    """Return the best set, None of an empty list."""
    return max(sets, key=lambda item: item.score, default=None)


@dataclass(slots=True, eq=False)
class Sets:
    """Over one lot of runs. nuisances : of the twin as it is given"""

    candidates: Candidates
    progress: Telling
    nuisances: tuple[SizedTerm, ...] = ()
    pool: SideBySide = field(default_factory=SideBySide)
    _known: dict[Names, ScoredSet] = field(default_factory=dict)
    _shortened: set[tuple[Names, str]] = field(default_factory=set)
    _as_they_are: dict[tuple[ScoredSet, tuple[str, ...]], ScoredSet] = field(default_factory=dict)

    def base(self) -> ScoredSet:
        """Return the twin as given."""
        file, runs = self.candidates.file, self.candidates.runs
        if frozenset() not in self._known:
            self._refine({frozenset(): Trial(file, first_levels(file, runs), self.nuisances)})
        return self._known[frozenset()]

    def fit(self, wanted: Mapping[Names, Trial], again: int = AGAIN) -> list[ScoredSet]:
        """Fit sets with noise levels of their own. Trials are given for those not yet known.

        again : how many of these, the best, may begin again
        """
        self._refine({key: trial for key, trial in wanted.items() if key not in self._known}, again)
        return [self._known[key] for key in wanted]

    def worth(self, item: ScoredSet, names: Sequence[str]) -> dict[str, float]:
        """By how much a set is better with each of its effects than without [nats]."""
        less = self.less(item, names)
        return {name: item.score - found.score for name, found in zip(names, less, strict=True)}

    def without(self, item: ScoredSet, name: str) -> ScoredSet:
        """Return the set without one effect."""
        return self.less(item, [name])[0]

    def less(self, item: ScoredSet, names: Sequence[str]) -> list[ScoredSet]:
        """Return the set without each of these effects in turn, fitted from here too,
        since an earlier fit may have ended lower.
        """
        keys = {item.added - {name}: name for name in names}
        new = {key: name for key, name in keys.items() if (item.added, name) not in self._shortened}
        self._shortened |= {(item.added, name) for name in new.values()}
        self._refine({key: self.shorten(item, name) for key, name in new.items()}, again=0)
        return [self._known[key] for key in keys]

    def as_they_are(self, item: ScoredSet, groups: Sequence[Sequence[str]]) -> list[ScoredSet]:
        """Return the set without some effects at its own noise: noise fitted
        without them might absorb them.
        """
        keys = [(item, tuple(names)) for names in groups]
        new = [key for key in keys if key not in self._as_they_are]
        trials = [self.shorten(item, *names) for _, names in new]
        fitted = self.pool.map(partial(fit, runs=self.candidates.runs, iterations=SCREENED), trials)
        for (_, names), one in zip(new, fitted, strict=True):
            self._as_they_are[item, names] = self._score(item.added - set(names), one)
        return [self._as_they_are[key] for key in keys]

    def as_usual(self, like: ScoredSet, names: Names) -> Trial:
        """Return a trial of a set of effects that begins at their usual values."""
        given = self.candidates.file
        file = replace(like.fit.file, effects=dict(given.effects))
        for name in sorted(names - self.candidates.formulas.keys()):
            file = with_usual(file, name)
        return begin(self._trial(file, like.fit.trial), given, self.candidates.runs)

    def thaw(self, beside: ScoredSet, found: ScreenedCandidate) -> Trial:
        """Return a screened candidate with every value free."""
        file, like = beside.fit.file, beside.fit.trial
        if found.file is None:
            formula = self.candidates.formulas[found.name]
            return self._trial(file, replace(like, nuisances=(*like.nuisances, formula)))
        effects = {**file.effects, found.name: found.file.effects[found.name]}
        return self._trial(replace(file, effects=effects), like)

    def shorten(self, item: ScoredSet, *names: str) -> Trial:
        """Return a trial of a set without some effects, from the set's present values."""
        file, like = item.fit.file, item.fit.trial
        effects = {own: values for own, values in file.effects.items() if own not in names}
        kept = tuple(term for term in like.nuisances if term.name not in names)
        return self._trial(replace(file, effects=effects), replace(like, nuisances=kept))

    def _trial(self, file: TwinFile, like: Trial) -> Trial:
        """Return a trial that starts at a file's values, with the priors of the given twin."""
        given = self.candidates.file
        replaced = {EFFECTS[name].replaces for name in file.effects} & set(given.effects)
        file = replace(file, effects={**file.effects, **{name: given.effects[name] for name in replaced}})
        priors = {item.place: item for item in unknowns(given)}
        free = tuple(priors.get(item.place, item) for item in unknowns(file))
        return replace(like, file=file, free=free)

    def _refine(self, wanted: Mapping[Names, Trial], again: int = AGAIN) -> None:
        """Fit, and keep what is better than before."""
        if not wanted:
            return
        self.progress(f"{len(wanted)} sets with noise of their own")
        file, runs = self.candidates.file, self.candidates.runs
        found = refine(list(wanted.values()), file, runs, again, self.pool)
        for key, item in zip(wanted, found, strict=True):
            scored = self._score(key, item)
            if key not in self._known or scored.score > self._known[key].score:
                self._known[key] = scored

    def _score(self, key: Names, item: FittedTwin) -> ScoredSet:
        nats = likelihood(item, self.candidates.file)
        return ScoredSet(key, item, nats, nats - sum(self.candidates.penalty(name) for name in key))
