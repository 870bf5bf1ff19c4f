"""Which effects are missing: a search over sets of named effects, each fitted by maximum likelihood.

Sets are compared by their likelihood less what their effects cost (`edge.twin.diagnosis.candidates`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations

from edge.twin.diagnosis.candidates import Candidates, Names, Scored
from edge.twin.diagnosis.fitting import fit
from edge.twin.diagnosis.noise_levels import first_levels
from edge.twin.diagnosis.progress import Progress
from edge.twin.diagnosis.refining import AGAIN, SEVERAL, begun, likelihood, refined
from edge.twin.diagnosis.screening import FORMULAS, SCREENED, Candidate, Screening
from edge.twin.diagnosis.side_by_side import SideBySide
from edge.twin.diagnosis.starts import with_usual
from edge.twin.diagnosis.trial import Term, Trial
from edge.twin.diagnosis.unknowns import unknowns
from edge.twin.effects import EFFECTS
from edge.twin.recorded import Recorded
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
# A light body is a capacity of the air, a light wall a loss too: what may be taken apart, and into what.
TAKEN_APART = {
    "wall_mass": (("wall_loss", "extra_capacity"), ("wall_mass", "extra_capacity")),
    "soil_mass": (("soil_mass", "extra_capacity"),),
}
RIVAL_NATS = 3.0  # a set as likely as the best within this is its rival
WORTH_A_LOOK = 12.0  # nats within which a screened rival is fitted with noise levels of its own


@dataclass(frozen=True, slots=True)
class Tried:
    """A candidate in a round."""

    name: str
    gain_nats: float  # over the set that it was added to
    score_gain: float  # after the penalty


@dataclass(frozen=True, slots=True)
class Round:
    """One more effect beside a set."""

    beside: Names
    tried: tuple[Tried, ...]


@dataclass(slots=True, eq=False)
class Search:
    """Sets fitted so far, over one lot of runs."""

    file: TwinFile
    runs: Recorded
    progress: Progress
    nuisances: tuple[Term, ...] = ()
    formulas: Mapping[str, Term] = field(default_factory=dict)
    doors: int = 0
    rounds: list[Round] = field(default_factory=list)
    held_out: dict[str, float] = field(default_factory=dict)
    shared: SideBySide = field(default_factory=SideBySide)
    candidates: Candidates = field(init=False)
    screening: Screening = field(init=False)
    _known: dict[Names, Scored] = field(default_factory=dict)
    _shortened: set[tuple[Names, str]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.candidates = Candidates(self.file, self.runs, self.formulas, self.doors)
        self.screening = Screening(self.candidates, self.runs, self.progress, self.shared)

    def penalty(self, name: str) -> float:
        """Of naming an effect, or of a formula [nats]."""
        return self.candidates.penalty(name)

    def base(self) -> Scored:
        """The twin as it is given."""
        if frozenset() not in self._known:
            self._refined({frozenset(): Trial(self.file, first_levels(self.file, self.runs), self.nuisances)})
        return self._known[frozenset()]

    def missing(self) -> Scored:
        """The set that is worth most: of names, of formulas, or of names with what formulas leave of them.

        Names are sought by themselves first, as a formula can stand for two of them and so end the search.
        """
        vague = self.unnamed()
        named = self._names(vague.score)
        both = self._pruned(self._extended(named, 1))
        return max((named, both, vague), key=lambda item: item.score)

    def unnamed(self) -> Scored:
        """The set of formulas alone that is worth most, the twin as it is given where none is."""
        return self._extended(self.base(), FORMULAS)

    def _names(self, rival: float) -> Scored:
        """Names alone: grown one by one, pruned, and with each member exchanged.

        rival : what formulas are worth; a set of several names that is worth less follows what has none
        """
        best, seen = self.base(), set[Names]()
        while len(best.added) < LARGEST_SET and best.added not in seen:
            if len(best.added) >= MIMICS and best.score < rival:
                break
            seen.add(best.added)
            best = self._pruned(self._next(best))
        return best

    def _next(self, best: Scored) -> Scored:
        """A better set: a body taken apart, one more effect or one exchanged; `best` where there is none."""
        apart = self._apart(best)
        if apart is not None:
            return apart
        grown = self._best_of(self._grown(best))
        margin = NEXT_MARGIN if best.added else MARGIN
        if grown and grown.score >= best.score + margin:
            return grown
        exchanged = self._exchanged(best)
        return exchanged if exchanged is not best else self._merged(best)

    def _extended(self, item: Scored, most: int) -> Scored:
        """A set with up to so many formulas, as far as each is worth it."""
        for _ in range(most):
            found = self.screening.formulas_beside(item)
            grown = self._best_of(self._looked_at(item, self._promising(found)))
            if grown is None or grown.score < item.score + MARGIN:
                break
            item = grown
        return item

    def _apart(self, best: Scored) -> Scored | None:
        """The set with a body that stood for two taken apart, where that explains more."""
        wanted = {}
        for name in sorted(best.added & TAKEN_APART.keys()):
            for parts in TAKEN_APART[name]:
                key = best.added - {name} | set(parts)
                if len(key) > len(best.added) and key - best.added <= set(self.candidates.names):
                    wanted[key] = self._as_usual(best, key)
        self._refined({key: trial for key, trial in wanted.items() if key not in self._known})
        found = self._best_of([self._known[key] for key in wanted])
        if found is None:
            return None
        margin = NEXT_MARGIN if found.added > best.added else 0.0
        return found if found.score > best.score + margin else None

    def _as_usual(self, like: Scored, names: Names) -> Trial:
        """A trial of a set of effects that begins at their usual values."""
        file = replace(like.fitted.file, effects=dict(self.file.effects))
        for name in sorted(names - self.formulas.keys()):
            file = with_usual(file, name)
        return begun(self._trial(file, like.fitted.trial), self.file, self.runs)

    def _best_of(self, sets: Sequence[Scored]) -> Scored | None:
        return max(sets, key=lambda item: item.score, default=None)

    def _grown(self, beside: Scored) -> list[Scored]:
        """A set with one more effect, those that promise most."""
        screened = self.screening.beside(beside)
        self.rounds.append(self._round(beside, screened))
        return self._looked_at(beside, self._promising([item for item in screened if item.file is not None]))

    def _looked_at(self, beside: Scored, found: Sequence[Candidate]) -> list[Scored]:
        """Candidates of a screening with noise of their own."""
        wanted = {beside.added | {item.name}: self.thawed(beside, item) for item in found}
        self._refined({key: trial for key, trial in wanted.items() if key not in self._known})
        return [self._known[key] for key in wanted]

    def _exchanged(self, item: Scored) -> Scored:
        """The set with one member exchanged for a better one, if there is one."""
        names = sorted(item.added)
        if len(names) > MOST_EXCHANGED:
            names = sorted(names, key=self.worth(item, names).__getitem__)[:MOST_EXCHANGED]
        found = self.rivals(item, names, EXCHANGED)
        return self._better([other for own in found.values() for other in own], item)

    def _merged(self, item: Scored) -> Scored:
        """The set with two members exchanged for one that does what both did, if there is one."""
        names = sorted(item.added & EFFECTS.keys())
        if len(item.added) < SEVERAL or len(names) < 2:
            return item
        worth = self.worth(item, names)
        pairs = sorted(combinations(names, 2), key=lambda pair: worth[pair[0]] + worth[pair[1]])
        besides = self._as_they_are(item, pairs[:MERGED_PAIRS])
        places = [
            (beside, [other for other in screened if other.file and other.name not in item.added])
            for beside, screened in zip(besides, self.screening.closely_beside(besides), strict=True)
        ]
        found = self._in_place(item, [(beside, own[:MERGED_INTO]) for beside, own in places])
        return self._better([other for own in found for other in own], item)

    def _better(self, found: Sequence[Scored], item: Scored) -> Scored:
        best = self._best_of(found)
        return item if best is None or best.score <= item.score + EXCHANGE_NATS else best

    def rivals(self, item: Scored, names: Sequence[str], most: int = REFINED) -> dict[str, list[Scored]]:
        """For each of some members the sets in which another candidate stands in its place and comes near."""
        besides = self._as_they_are(item, [(name,) for name in names])
        places = []
        for name, beside, screened in zip(
            names, besides, self.screening.closely_beside(besides), strict=True
        ):
            near = self._near(item, name, beside, screened)
            lent = replace(
                beside.fitted, file=self._short(item, name).file
            )  # values that a rival lives with too
            places.append((replace(beside, fitted=lent), near[:most]))
        return dict(zip(names, self._in_place(item, places), strict=True))

    def _near(
        self, item: Scored, name: str, beside: Scored, screened: Sequence[Candidate]
    ) -> list[Candidate]:
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
        self, item: Scored, places: Sequence[tuple[Scored, Sequence[Candidate]]]
    ) -> list[list[Scored]]:
        """What is left of a set, with candidates in the place of what is gone; noise from the set's on."""
        wanted: dict[Names, Trial] = {}
        keys: list[list[Names]] = []
        for beside, found in places:
            trials = {
                beside.added | {other.name}: replace(
                    self.thawed(beside, other), levels=item.fitted.trial.levels
                )
                for other in found
            }
            keys.append(list(trials))
            wanted |= {key: trial for key, trial in trials.items() if key not in self._known}
        self._refined(wanted, again=AGAIN * len(places))
        return [[self._known[key] for key in own] for own in keys]

    def _promising(self, screened: Sequence[Candidate]) -> Sequence[Candidate]:
        """The first, and those not far behind it, as long as they explain something."""
        worth = [item.gain - self.penalty(item.name) for item in screened]
        if not worth:
            return []
        least = max(worth[0] - max(WORTH_A_LOOK, BEHIND * abs(worth[0])), HOPELESS_NATS)
        near = [item for item, own in zip(screened, worth, strict=True) if own >= least]
        return near[:REFINED] or screened[:1]

    def _round(self, beside: Scored, screened: Sequence[Candidate]) -> Round:
        tried = (Tried(item.name, item.gain, item.gain - self.penalty(item.name)) for item in screened)
        return Round(beside.added, tuple(tried))

    def _as_they_are(self, item: Scored, groups: Sequence[Sequence[str]]) -> list[Scored]:
        """The set less some effects, with its own noise: levels found without them might swallow them."""
        trials = [self._short(item, *names) for names in groups]
        fitted = self.shared.map(partial(fit, runs=self.runs, iterations=SCREENED), trials)
        found = []
        for names, one in zip(groups, fitted, strict=True):
            nats, key = likelihood(one, self.file), item.added - set(names)
            found.append(Scored(key, one, nats, nats - sum(self.penalty(name) for name in key)))
        return found

    def thawed(self, beside: Scored, found: Candidate) -> Trial:
        """A screened candidate with all that may move."""
        file, like = beside.fitted.file, beside.fitted.trial
        if found.file is None:
            return self._trial(file, replace(like, nuisances=(*like.nuisances, self.formulas[found.name])))
        effects = {**file.effects, found.name: found.file.effects[found.name]}
        return self._trial(replace(file, effects=effects), like)

    def _trial(self, file: TwinFile, like: Trial) -> Trial:
        """A trial that starts at a file's values, with the priors of what was given."""
        replaced = {EFFECTS[name].replaces for name in file.effects} & set(self.file.effects)
        given = {name: self.file.effects[name] for name in replaced}
        file = replace(file, effects={**file.effects, **given})
        priors = {item.place: item for item in unknowns(self.file)}
        free = tuple(priors.get(item.place, item) for item in unknowns(file))
        return replace(like, file=file, free=free)

    def _refined(self, wanted: dict[Names, Trial], again: int = AGAIN) -> None:
        """Fit with noise levels of their own, and keep what is better than before."""
        if not wanted:
            return
        self.progress(f"{len(wanted)} sets with noise of their own")
        found = refined(list(wanted.values()), self.file, self.runs, again, self.shared)
        for key, item in zip(wanted, found, strict=True):
            nats = likelihood(item, self.file)
            score = nats - sum(self.penalty(name) for name in key)
            if key not in self._known or score > self._known[key].score:
                self._known[key] = Scored(key, item, nats, score)

    def worth(self, item: Scored, names: Sequence[str]) -> dict[str, float]:
        """By how much a set is better with each of its effects than without [nats]."""
        less = self._less(item, names)
        return {name: item.score - found.score for name, found in zip(names, less, strict=True)}

    def without(self, item: Scored, name: str) -> Scored:
        """The set less one effect."""
        return self._less(item, [name])[0]

    def _less(self, item: Scored, names: Sequence[str]) -> list[Scored]:
        """The set less one effect, for each of them: fitted from here too, where it may have ended lower."""
        keys = {item.added - {name}: name for name in names}
        new = {key: name for key, name in keys.items() if (item.added, name) not in self._shortened}
        self._shortened |= {(item.added, name) for name in new.values()}
        self._refined({key: self._short(item, name) for key, name in new.items()}, again=0)
        return [self._known[key] for key in keys]

    def _short(self, item: Scored, *names: str) -> Trial:
        file, like = item.fitted.file, item.fitted.trial
        effects = {own: values for own, values in file.effects.items() if own not in names}
        kept = tuple(term for term in like.nuisances if term.name not in names)
        return self._trial(replace(file, effects=effects), replace(like, nuisances=kept))

    def _pruned(self, item: Scored) -> Scored:
        """The set without effects that the others make needless."""
        while len(item.added) > 1:
            least = self._best_of(self._less(item, sorted(item.added)))
            if least is None or least.score < item.score - NEXT_MARGIN:
                break
            item = least
        return item
