"""From what the search found to what is said and handed over: by rows that no fit saw."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.candidates import Names, ScoredSet
from edge.diagnosis.evidence import HALF, NameEvidence, evidence_of
from edge.diagnosis.formulas import FormulaShape
from edge.diagnosis.free_fit import APART_SDS, another, apart, rms_k
from edge.diagnosis.handover import (
    NO_WORSE,
    OPEN,
    Comparison,
    JudgedTwin,
    free_values,
    impossible,
    none_at_all,
    rmse,
)
from edge.diagnosis.noise_levels import first_levels
from edge.diagnosis.prepare import PreparedRuns, errors_over
from edge.diagnosis.progress import Telling
from edge.diagnosis.runs import NamedRun
from edge.diagnosis.search import WORTH_A_LOOK, Search
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import FittedTwin
from edge.diagnosis.unknowns import with_usual
from edge.diagnosis.verdict import DiagnosisVerdict, MissingEffect, intervals, read, unnamed_verdict
from edge.twin.effects.effect import Effect, Offer, ParameterKind
from edge.twin.effects.library import EFFECTS, common_effects
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import TwinFile
from edge.twin.value import SDS_95, Value

Floats = NDArray[np.float64]
MOST_UNNAMED = 2
FIRST_FEW = 3  # of the search's last round, that are tried too
LESS_SEEN = 0.97  # times the error over rows that were fitted, for left-out rows to be looked at
LESS_UNNAMED = 0.7  # times the error, and that with any term that has a cause, for one that says none
EXPLAINED = 2.0  # times a reading's noise: free runs that miss by less lack nothing that matters
FAR_FROM_NOISE = 10.0  # here something is, whatever the likelihood took it for
NEVER_MOVED = 0.1  # of a coordinate, that is the same still
REFUTED_FROM = 1.1  # times the error over test runs without a name


@dataclass(frozen=True, slots=True)
class Doubtful:
    """An effect that the search found and that does not stand."""

    effect: MissingEffect
    against: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisJudgement:
    """verdict : with the names that stand; handed : the twin to hand over, perhaps with more than names

    other : the same twin with other values that do as well, None where there are none
    """

    verdict: DiagnosisVerdict
    doubtful: tuple[Doubtful, ...]
    standings: Mapping[str, NameEvidence]
    comparison: Comparison
    handover: JudgedTwin
    other: FittedTwin | None

    @property
    def provisional(self) -> tuple[str, ...]:
        """Effects of the twin that is handed over whose names do not stand."""
        return tuple(sorted(self.handover.added - {item.name for item in self.verdict.effects} - {OPEN}))

    @property
    def notes(self) -> tuple[str, ...]:
        """Other values that do as well, and values of the twin file that the runs contradict, sentences."""
        told = [] if self.other is None else [_other_values(self.handover.fit, self.other)]
        if OPEN not in self.handover.added:
            return tuple(told)
        given = self.comparison.inputs.file.values()
        for item, x in self.handover.open_values:
            if item.place not in given or (rel_sd := given[item.place].rel_sd) is None:
                continue
            stated = given[item.place].value
            if abs(item.value(x) / stated - 1.0) > SDS_95 * rel_sd:
                told.append(
                    f"{'.'.join(item.place)} is {item.value(x):.3g}, where the twin file says "
                    f"{stated:.3g} and to {100.0 * rel_sd:.0f} %"
                )
        return tuple(told)


def judge(
    search: Search,
    found: DiagnosisVerdict,
    known: PreparedRuns,
    shapes: Mapping[str, FormulaShape],
    shared: SideBySide,
    telling: Telling,
    tests: Sequence[NamedRun] = (),
) -> DiagnosisJudgement:
    """Keep the names that stand, and choose the twin. tests : runs that are only judged by"""
    comparison = Comparison(known, search.sets.base().fit.trial.levels.sensor_k, shared, telling)
    # A twin that lacks much takes some of that for noise of a reading.
    noise_k = min(comparison.noise_k, first_levels(known.file, known.runs).sensor_k)
    effects, doubtful = list(found.effects), list[Doubtful]()
    every: dict[str, NameEvidence] = {}
    refused = set[str]()
    while True:
        comparison.add(_files(known.file, search, effects))
        effects, exchanged = _exchange(search, comparison, effects)
        doubtful += exchanged
        names = frozenset(effect.name for effect in effects)
        whole = score_set(search, names)
        if not names and comparison.trials[names].rmse_k <= EXPLAINED * noise_k:
            handed = comparison.trials[names]
            break
        if not names:
            handed = _with_unnamed(search, comparison, names, noise_k)
            if not (more := _thought_of(search, comparison, handed, names, refused)):
                break
            effects = list(read(search, score_set(search, more)))
            continue
        without = {name: search.sets.without(whole, name) for name in names}
        tries = len(search.candidates.names) + len(search.candidates.formulas)
        comparison.add(_files(known.file, search, effects))
        now = evidence_of(whole, without, comparison, tries)
        every |= now
        against = {name: item.against for name, item in now.items() if item.against}
        if not against:
            handed = _with_unnamed(search, comparison, names, noise_k)
            # With what else is in that twin a name may have become what it can't be.
            for name in names:
                said = impossible(name, handed.fit, known.runs, known.file.sample_s)
                said += none_at_all(name, handed.fit)
                said += _refutations(name, names, comparison, tests)
                if said:
                    against[name] = tuple(said)
        if not against:
            if not (more := _thought_of(search, comparison, handed, names, refused)):
                break
            effects = list(read(search, score_set(search, names | more)))
            continue
        refused |= against.keys()
        doubtful += [Doubtful(effect, against[effect.name]) for effect in effects if effect.name in against]
        effects = [effect for effect in effects if effect.name not in against]
    comparison.add_simple()
    text = _final_verdict(search, found, tuple(effects), handed, shapes, noise_k)
    other = another(handed.fit, known.runs, comparison.noise_k, shared)
    return DiagnosisJudgement(text, tuple(doubtful), every, comparison, handed, other)


def _other_values(found: FittedTwin, other: FittedTwin) -> str:
    own, far = (item.file.values() for item in (found, other))
    told = [
        f"{'.'.join(item.place)} {far[item.place].value:.3g} in the place of {own[item.place].value:.3g}"
        for item in apart(found, other)
    ]
    return f"Other values do as well: {', '.join(told)}"


def score_set(search: Search, names: Names) -> ScoredSet:
    """Return a set of names with its likelihood."""
    base = search.sets.base()
    return search.sets.fit({names: search.sets.as_usual(base, names)})[0] if names else base


def _exchange(
    search: Search, comparison: Comparison, effects: list[MissingEffect]
) -> tuple[list[MissingEffect], list[Doubtful]]:
    """With another name in the place of one, where free runs are clearly better with it."""
    names = frozenset(effect.name for effect in effects)
    if not names:
        return effects, []
    own = comparison.trials[names]
    others = [
        item
        for key, item in comparison.trials.items()
        if len(key) == len(names) == len(key & names) + 1
        and key <= set(search.candidates.names)
        and comparison.is_better(item, own)
    ]
    best = min(others, key=lambda item: item.rmse_k, default=None)
    # Where the likelihood says the opposite, nothing is exchanged.
    if (
        best is None
        or score_set(search, best.added).likelihood < score_set(search, names).likelihood - WORTH_A_LOOK
    ):
        return effects, []
    (gone,) = names - best.added
    (placed,) = best.added - names
    why = (
        f"free runs miss left-out rows by {own.rmse_k:.3g} K with it, by {best.rmse_k:.3g} K with {placed} "
        "in its place"
    )
    left = [Doubtful(effect, (why,)) for effect in effects if effect.name == gone]
    return list(read(search, score_set(search, best.added))), left


def _files(file: TwinFile, search: Search, effects: Iterable[MissingEffect]) -> dict[Names, TwinFile]:
    """Return the sets to compare: the names, one fewer, one more, and another name in the place of each."""
    names = [effect.name for effect in effects]
    keys = [frozenset(names[:count]) for count in range(len(names) + 1)]
    keys += [frozenset(names) - {name} for name in names]
    # Common effects stand for a name that fails, where they predict clearly better.
    usual = [name for name in common_effects() if name in search.candidates.names]
    keys += [frozenset(names) | {other} for other in usual]
    for effect in effects:
        rivals = {*usual, *effect.alternatives} - set(names)
        keys += [frozenset(names) - {effect.name} | {other} for other in rivals]
    commonest = frozenset(common_effects()[:2])
    if not names and commonest <= set(usual):
        keys.append(commonest)
    return {key: _with(file, key) for key in keys}


def _refutations(name: str, names: Names, comparison: Comparison, tests: Sequence[NamedRun]) -> list[str]:
    """Test runs that are predicted worse with a name."""
    both = [comparison.trials[names], comparison.trials[names - {name}]]
    own, less = (rmse(_test_errors(tests, item.fit, comparison.inputs)) for item in both)
    if not own > REFUTED_FROM * less:
        return []
    return [f"free runs miss the test runs by {own:.3g} K with it, by {less:.3g} K without"]


def _test_errors(tests: Sequence[NamedRun], fitted: FittedTwin, known: PreparedRuns) -> Floats:
    """Errors over test runs, without their means where no room was recorded: that may be anything there."""
    every = [errors_over([test], fitted, known) for test in tests]
    if known.guessed:
        every = [item - np.nanmean(item) if np.isfinite(item).any() else item for item in every]
    return np.concatenate([np.empty(0), *every])


def _thought_of(
    search: Search, comparison: Comparison, handed: JudgedTwin, names: Names, refused: set[str]
) -> Names:
    """Effects that the search did not name and that take away most of what free runs missed by."""
    more = handed.added & set(search.candidates.names) - names - refused
    refused |= more  # each is thought of once
    less = comparison.trials[names].rmse_k
    return frozenset(more) if more and handed.rmse_k < HALF * less else frozenset()


def _with_unnamed(search: Search, comparison: Comparison, names: Names, noise_k: float) -> JudgedTwin:
    """With what makes free runs clearly better over left-out rows, whatever it stands for.

    noise_k : of a reading
    """
    file, runs, handed = search.file, comparison.inputs.runs, comparison.choose(names)
    last = search.rounds[-1].candidates[:FIRST_FEW] if search.rounds else ()
    also = [item.name for item in last if item.name in search.candidates.names]
    usual = [name for name in common_effects() if name in search.candidates.names]
    # Where much is unexplained, a twin without a name predicts better with these.
    stand_ins = [name for name, effect in EFFECTS.items() if effect.stands_in and _moves(effect, file, runs)]
    possible = [name for name in dict.fromkeys((*usual, *also, *stand_ins, OPEN)) if name not in file.effects]
    if not any(value.rel_sd for value in file.values().values()):
        possible.remove(OPEN)
    middle_c = float(np.nanmedian(runs.temp))
    for _ in range(MOST_UNNAMED):
        if handed.rmse_k <= EXPLAINED * noise_k:
            break
        wanted = [handed.added | {name} for name in possible if name not in handed.added]
        most_k = LESS_SEEN * rms_k(handed.fit, runs)
        comparison.add({key: _with(file, key, middle_c) for key in wanted}, most_k)
        found = [comparison.trials[key] for key in wanted if key in comparison.trials]
        most_start_k = NO_WORSE * comparison.from_start_k(handed)
        sound = [
            item
            for item in found
            if not item.at_bound
            and (_is_known(item.added - handed.added) or not _is_moved(handed, item))
            and comparison.is_better_throughout(item, handed)
            and comparison.is_sound(item, most_start_k)
        ]
        best = min(sound, key=lambda item: _worth_k(item, handed), default=handed)
        if best is handed or _worth_k(best, handed) > handed.rmse_k:
            break
        handed = best
    return handed


def _is_known(added: Names) -> bool:
    """Return whether all of them are what some boxes have, and no diagnosis seeks.

    Films thin in every warm box. A name's value that moves with that was wrong without.
    """
    return all(name in EFFECTS and EFFECTS[name].offer is Offer.KNOWN_ONLY for name in added)


def _worth_k(item: JudgedTwin, than: JudgedTwin) -> float:
    """Return what it misses by; more where it adds a term that says nothing of its cause."""
    added = (EFFECTS.get(name) for name in item.added - than.added)
    nameless = any(effect is not None and effect.offer is Offer.NAMELESS for effect in added)
    return item.rmse_k / LESS_UNNAMED if nameless else item.rmse_k


def _moves(effect: Effect, file: TwinFile, runs: RunBatch) -> bool:
    """Return True where all commands change without which the effect says nothing; no fan does not."""
    commands = {"heater_duty": runs.duty, "fan_on": runs.fan if file.fan_role != "none" else 0.0}
    return all(np.ptp(commands[key]) > 0.0 for key in effect.must_change)


def _is_moved(handed: JudgedTwin, item: JudgedTwin) -> bool:
    """Return whether an effect changes its value once another is added, so that the other stands for it."""
    there = {own.place: (x, sd) for own, x, sd in item.spreads}
    for own, x, sd in handed.spreads:
        is_added = own.place[0] == "effects" and own.place[1] in handed.added
        other, other_sd = there.get(own.place, (x, sd))  # gone where another effect replaces it
        if is_added and abs(other - x) > max(APART_SDS * np.hypot(sd, other_sd), NEVER_MOVED):
            return True
    return False


def _with(file: TwinFile, names: Names, middle_c: float = 0.0) -> TwinFile:
    """middle_c : of the air, about which a heat without a name may turn"""
    for name in sorted(names - {OPEN}):
        file = with_usual(file, name)
        for item in EFFECTS[name].parameters:
            if item.kind is ParameterKind.TURNING_POINT:
                file = file.with_values({("effects", name, item.name): Value(middle_c, fit=True)})
    return free_values(file) if OPEN in names else file


def _final_verdict(
    search: Search,
    found: DiagnosisVerdict,
    effects: tuple[MissingEffect, ...],
    handed: JudgedTwin,
    shapes: Mapping[str, FormulaShape],
    noise_k: float,
) -> DiagnosisVerdict:
    """Return the verdict with the standing names and the values that are handed over."""
    valued = tuple(_with_values(effect, handed) for effect in effects)
    if valued:
        return replace(found, kind="named", effects=valued, depends_on=())
    if handed.rmse_k <= EXPLAINED * noise_k and not handed.added - {OPEN}:
        return replace(found, kind="nothing_missing", effects=(), depends_on=(), formula=())
    too_far = handed.rmse_k > FAR_FROM_NOISE * noise_k
    if found.effects or (found.kind == "nothing_missing" and (handed.added - {OPEN} or too_far)):
        return unnamed_verdict(search, shapes)
    return found


def _with_values(effect: MissingEffect, handed: JudgedTwin) -> MissingEffect:
    values, bound = intervals(handed.fit, effect.name)
    return replace(effect, parameters=values, at_bound=bound)
