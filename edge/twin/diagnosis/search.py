"""Which effects are missing: a search over sets of named effects, each fitted by maximum likelihood.

A set is worth its likelihood less half log(rows) for each value found (BIC, Schwarz 1978) and log(candidates)
for each effect chosen among them (Chen & Chen 2008, Biometrika 95: the extended BIC), so that the chance that
any of the candidates is named by luck stays small however many are tried.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from edge.twin.diagnosis.fitting import Fitted, Term, Trial, fit, slopes
from edge.twin.diagnosis.innovations import NoiseLevels
from edge.twin.diagnosis.noise_levels import find_levels, first_levels, level_prior
from edge.twin.diagnosis.progress import Progress
from edge.twin.diagnosis.starts import settled, with_effect
from edge.twin.diagnosis.unknowns import unknowns
from edge.twin.effects import EFFECTS, USUAL_EFFECTS
from edge.twin.recorded import Recorded
from edge.twin.twin_file import TwinFile

Names = frozenset[str]
REFINED = 6  # candidates of a round that get noise levels of their own
FIRST_LOOK, SCREENED, REFITTED = 1, 4, 3  # iterations
LARGEST_SET = 7
BEHIND = 0.5  # share of the first one's gain by which another may be behind, to be looked at again
FORMULAS = 2  # in one set: more of them can follow anything
EXCHANGE_NATS = 0.5
FORMULA_NATS = 4.0  # by which a formula must be better than a name
MARGIN = 3.0  # nats beyond the penalty, as the noise is not quite what the model says
RIVAL_NATS = 3.0  # a set as likely as the best within this is its rival
WORTH_A_LOOK = 12.0  # nats within which a screened rival is fitted with noise levels of its own


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """A set of effects beside those that were known, at its best.

    likelihood : nats, noise levels' prior included; score : less the penalty
    """

    added: Names
    fitted: Fitted
    likelihood: float
    score: float


@dataclass(frozen=True, slots=True)
class Tried:
    """A candidate in a round."""

    name: str
    gain_nats: float  # over the set that it was added to
    score_gain: float  # after the penalty
    refined: bool  # whether its noise levels were found


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
    rounds: list[Round] = field(default_factory=list)
    held_out: dict[str, float] = field(default_factory=dict)
    _known: dict[Names, Scored] = field(default_factory=dict)
    _screened: dict[Names, list[tuple[str, Fitted]]] = field(default_factory=dict)

    @property
    def candidates(self) -> list[str]:
        """Effects that may be missing: the usual ones that are not there and have their columns."""
        have = set(self.runs.conditions)
        return [
            name
            for name, effect in USUAL_EFFECTS.items()
            if name not in self.file.effects and set(effect.needs) <= have and self._can_be(name)
        ]

    def _can_be(self, name: str) -> bool:
        if name == "door_opening":
            return "door_open" in self.runs.conditions
        if name == "ua_drift":
            return True
        return not (name == "wall_loss" and "wall_mass" in self.file.effects)

    @property
    def rows(self) -> int:
        """Temperatures that are fitted to."""
        return int(np.isfinite(self.runs.temp[:, 1:]).sum())

    def penalty(self, name: str) -> float:
        """Of naming an effect, or of a formula [nats]."""
        if name in self.formulas:
            return 0.5 * float(np.log(self.rows)) + float(np.log(len(self.formulas))) + FORMULA_NATS
        values = len(EFFECTS[name].parameters)
        if name == "wall_mass" and "wall_loss" in self.file.effects:
            values -= 1  # what its films give in series is known
        return 0.5 * values * float(np.log(self.rows)) + float(np.log(len(self.candidates)))

    def base(self) -> Scored:
        """The twin as it is given."""
        if frozenset() not in self._known:
            self._refined({frozenset(): Trial(self.file, first_levels(self.file, self.runs), self.nuisances)})
        return self._known[frozenset()]

    def missing(self) -> Scored:
        """The set that is worth most: grown one by one, pruned, and with each member exchanged."""
        best = self.base()
        while len(best.added) < LARGEST_SET and not self._vague(best):
            grown = self._best_of(self._grown(best))
            if grown is None or grown.score < best.score + MARGIN:
                better = self._exchanged(best)
                if better is best:
                    break
                grown = better
            best = self._pruned(grown)
        return best

    def _vague(self, item: Scored) -> bool:
        """Whether a formula stands for something, so that one more name would only fill what it leaves."""
        return len(item.added) > 1 and bool(item.added & self.formulas.keys())

    def _best_of(self, sets: Sequence[Scored]) -> Scored | None:
        return max(sets, key=lambda item: item.score, default=None)

    def _grown(self, beside: Scored) -> list[Scored]:
        """A set with one more effect, those that promise most."""
        screened = self.screened(beside)
        self.rounds.append(self._round(beside, screened))
        return self._looked_at(beside, self._promising(beside, screened))

    def _looked_at(
        self, beside: Scored, found: Sequence[tuple[str, Fitted]], levels: NoiseLevels | None = None
    ) -> list[Scored]:
        """Candidates of a screening with noise of their own, sought from `levels` on."""
        wanted = {beside.added | {name}: self.thawed(beside, name, item) for name, item in found}
        if levels is not None:
            wanted = {key: replace(trial, levels=levels) for key, trial in wanted.items()}
        self._refined({key: trial for key, trial in wanted.items() if key not in self._known})
        return [self._known[key] for key in wanted]

    def _exchanged(self, item: Scored) -> Scored:
        """The set with one member exchanged for a better one, if there is one."""
        if len(item.added) < 2:
            return item
        for name in sorted(item.added):
            best = self._best_of(self.rivals(item, name))
            if best is not None and best.score > item.score + EXCHANGE_NATS:
                return best
        return item

    def rivals(self, item: Scored, name: str) -> list[Scored]:
        """The sets in which another candidate stands in the place of `name`, those that come near."""
        beside = self.without(item, name)
        screened = self.screened(beside)
        own = {key: found.log_likelihood for key, found in screened}.get(name)
        floor = (item.fitted.log_likelihood if own is None else own) - WORTH_A_LOOK
        near = [
            (key, found)
            for key, found in screened
            if key not in item.added
            and found.log_likelihood >= floor + self.penalty(key) - self.penalty(name)
        ]
        return self._looked_at(beside, near[:REFINED], item.fitted.trial.levels)

    def _promising(
        self, beside: Scored, screened: Sequence[tuple[str, Fitted]]
    ) -> Sequence[tuple[str, Fitted]]:
        """Those not far behind the first."""
        worth = [
            found.log_likelihood - beside.fitted.log_likelihood - self.penalty(name)
            for name, found in screened
        ]
        least = worth[0] - max(WORTH_A_LOOK, BEHIND * abs(worth[0])) if worth else 0.0
        return [item for item, own in zip(screened, worth, strict=True) if own >= least][:REFINED]

    def _round(self, beside: Scored, screened: Sequence[tuple[str, Fitted]]) -> Round:
        gains = [(name, found.log_likelihood - beside.fitted.log_likelihood) for name, found in screened]
        return Round(
            beside.added,
            tuple(Tried(name, gain, gain - self.penalty(name), False) for name, gain in gains),
        )

    def screened(self, beside: Scored) -> list[tuple[str, Fitted]]:
        """Each candidate beside a set, with the set's noise, the most promising first.

        What else may move, moves in proportion; each start gets one step, the best of each candidate more.
        """
        if beside.added not in self._screened:
            self._screened[beside.added] = self._screen(beside)
        return self._screened[beside.added]

    def _screen(self, beside: Scored) -> list[tuple[str, Fitted]]:
        names = [name for name in self.candidates if name not in beside.added]
        base = beside.fitted
        frozen = (*base.trial.nuisances, *slopes(base, self.runs))
        trials, owners = [], []
        for name in names:
            for file in with_effect(settled(base.file), name):
                trials.append(Trial(file, base.trial.levels, frozen))
                owners.append(name)
        self.progress(f"{_text(beside.added)}: {len(names)} candidates")
        first = _best(owners, fit(trials, self.runs, FIRST_LOOK))
        few = len(beside.added & self.formulas.keys()) < FORMULAS
        wanted = [term for name, term in self.formulas.items() if few and name not in beside.added]
        linear = [Trial(settled(base.file), base.trial.levels, (*frozen, term)) for term in wanted]
        again = fit(
            [replace(item.trial, file=item.file, free=item.free) for item in first.values()],
            self.runs,
            SCREENED,
        )
        every = [*zip(first, again, strict=True)]
        if linear:
            every += zip((term.name for term in wanted), fit(linear, self.runs, 0), strict=True)
        return sorted(every, key=lambda item: self.penalty(item[0]) - item[1].log_likelihood)

    def thawed(self, beside: Scored, name: str, found: Fitted) -> Trial:
        """A screened candidate with all that may move."""
        file = beside.fitted.file
        if name in self.formulas:
            like = beside.fitted.trial
            return self._trial(file, replace(like, nuisances=(*like.nuisances, self.formulas[name])))
        effects = {**file.effects, name: found.file.effects[name]}
        return self._trial(replace(file, effects=effects), beside.fitted.trial)

    def _trial(self, file: TwinFile, like: Trial) -> Trial:
        """A trial that starts at a file's values, with the priors of what was given."""
        replaced = {EFFECTS[name].replaces for name in file.effects} & set(self.file.effects)
        given = {name: self.file.effects[name] for name in replaced}
        file = replace(file, effects={**file.effects, **given})
        priors = {item.place: item for item in unknowns(self.file)}
        free = tuple(priors.get(item.place, item) for item in unknowns(file))
        return replace(like, file=file, free=free)

    def _refined(self, wanted: dict[Names, Trial]) -> None:
        """Fit with noise levels of their own, and keep."""
        if not wanted:
            return
        self.progress(f"{len(wanted)} sets with noise of their own")
        found = fit(list(wanted.values()), self.runs, REFITTED)
        for _ in range(2):
            found = fit(find_levels(found, self.file, self.runs), self.runs, REFITTED)
        for key, item in zip(wanted, found, strict=True):
            likelihood = item.log_likelihood + level_prior(item.trial.levels, self.file)
            score = likelihood - sum(self.penalty(name) for name in key)
            self._known[key] = Scored(key, item, likelihood, score)

    def without(self, item: Scored, name: str) -> Scored:
        """The set less one effect."""
        return self._less(item, [name])[0]

    def _less(self, item: Scored, names: Sequence[str]) -> list[Scored]:
        """The set less one effect, for each of them."""
        keys = {item.added - {name}: name for name in names}
        self._refined({key: self._short(item, name) for key, name in keys.items() if key not in self._known})
        return [self._known[key] for key in keys]

    def _short(self, item: Scored, name: str) -> Trial:
        file, like = item.fitted.file, item.fitted.trial
        effects = {own: values for own, values in file.effects.items() if own != name}
        kept = tuple(term for term in like.nuisances if term.name != name)
        return self._trial(replace(file, effects=effects), replace(like, nuisances=kept))

    def _pruned(self, item: Scored) -> Scored:
        """The set without effects that the others make needless."""
        while len(item.added) > 1:
            least = self._best_of(self._less(item, sorted(item.added)))
            if least is None or least.score < item.score - MARGIN:
                break
            item = least
        return item


def _best(names: Sequence[str], found: Sequence[Fitted]) -> dict[str, Fitted]:
    """The likeliest of each name."""
    best: dict[str, Fitted] = {}
    for name, item in zip(names, found, strict=True):
        if name not in best or item.log_likelihood > best[name].log_likelihood:
            best[name] = item
    return best


def _text(names: Names) -> str:
    return " + ".join(sorted(names)) or "as given"
