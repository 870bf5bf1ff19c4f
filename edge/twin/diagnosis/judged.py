"""From what the search found to what is said and handed over: by rows that no fit saw."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from edge.twin.diagnosis.candidates import Names, Scored
from edge.twin.diagnosis.formulas import Shape
from edge.twin.diagnosis.given import Given
from edge.twin.diagnosis.handed import Comparison, Predicted
from edge.twin.diagnosis.search import WORTH_A_LOOK, Search
from edge.twin.diagnosis.side_by_side import SideBySide
from edge.twin.diagnosis.standing import Standing, standing
from edge.twin.diagnosis.starts import with_usual
from edge.twin.diagnosis.verdict import Named, Verdict, intervals, read, unnamed
from edge.twin.twin_file import TwinFile

# What most boxes have more or less of: they stand for a name that fails, where they predict clearly better.
USUAL = ("heater_lag", "soil_mass", "sensor_lag", "imperfect_mixing")


@dataclass(frozen=True, slots=True)
class Doubtful:
    """An effect that the search found and that does not stand."""

    effect: Named
    against: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """verdict : with the names that stand; handed : the twin to hand over, perhaps with more than names"""

    verdict: Verdict
    doubtful: tuple[Doubtful, ...]
    standings: Mapping[str, Standing]
    comparison: Comparison
    handed: Predicted

    @property
    def provisional(self) -> tuple[str, ...]:
        """Effects of the twin that is handed over whose names do not stand."""
        return tuple(sorted(self.handed.added - {item.name for item in self.verdict.effects}))


def judged(
    search: Search, found: Verdict, known: Given, shapes: Mapping[str, Shape], shared: SideBySide
) -> Judged:
    """Keep the names that stand, and choose the twin."""
    comparison = Comparison(known, search.sets.base().fitted.trial.levels.sensor_k, shared)
    effects, doubtful = list(found.effects), list[Doubtful]()
    every: dict[str, Standing] = {}
    while True:
        comparison.add(_files(known.file, search, effects))
        effects, exchanged = _exchanged(search, comparison, effects)
        doubtful += exchanged
        names = frozenset(effect.name for effect in effects)
        whole = scored(search, names)
        if not names:
            break
        without = {name: search.sets.without(whole, name) for name in names}
        tries = len(search.candidates.names) + len(search.candidates.formulas)
        comparison.add(_files(known.file, search, effects))
        now = standing(whole, without, comparison, tries)
        every |= now
        failed = [effect for effect in effects if now[effect.name].against]
        if not failed:
            break
        doubtful += [Doubtful(effect, now[effect.name].against) for effect in failed]
        effects = [effect for effect in effects if effect not in failed]
    comparison.add_simple()
    handed = comparison.choose(names)
    said = _said(search, found, tuple(effects), handed, shapes)
    return Judged(said, tuple(doubtful), every, comparison, handed)


def scored(search: Search, names: Names) -> Scored:
    """A set of names as the likelihood has it."""
    base = search.sets.base()
    return search.sets.fitted({names: search.sets.as_usual(base, names)})[0] if names else base


def _exchanged(
    search: Search, comparison: Comparison, effects: list[Named]
) -> tuple[list[Named], list[Doubtful]]:
    """With another name in the place of one, where free runs are clearly better with it."""
    names = frozenset(effect.name for effect in effects)
    if not names:
        return effects, []
    own = comparison.tried[names]
    others = [
        item
        for key, item in comparison.tried.items()
        if len(key) == len(names) == len(key & names) + 1 and comparison.is_better(item, own)
    ]
    best = min(others, key=lambda item: item.rmse_k, default=None)
    # Where the likelihood says the opposite, nothing is exchanged.
    if (
        best is None
        or scored(search, best.added).likelihood < scored(search, names).likelihood - WORTH_A_LOOK
    ):
        return effects, []
    (gone,) = names - best.added
    (placed,) = best.added - names
    why = (
        f"free runs miss left-out rows by {own.rmse_k:.3g} K with it, by {best.rmse_k:.3g} K with {placed} "
        "in its place"
    )
    left = [Doubtful(effect, (why,)) for effect in effects if effect.name == gone]
    return list(read(search, scored(search, best.added))), left


def _files(file: TwinFile, search: Search, effects: Iterable[Named]) -> dict[Names, TwinFile]:
    """Sets to be compared: the names, fewer, more, and another one in the place of each."""
    names = [effect.name for effect in effects]
    keys = [frozenset(names[:count]) for count in range(len(names) + 1)]
    keys += [frozenset(names) - {name} for name in names]
    usual = [name for name in USUAL if name in search.candidates.names]
    keys += [frozenset(names) | {other} for other in usual]
    for effect in effects:
        rivals = {*usual, *effect.alternatives} - set(names)
        keys += [frozenset(names) - {effect.name} | {other} for other in rivals]
    if not names and {"heater_lag", "soil_mass"} <= set(usual):
        keys.append(frozenset({"heater_lag", "soil_mass"}))
    return {key: _with(file, key) for key in keys}


def _with(file: TwinFile, names: Names) -> TwinFile:
    for name in sorted(names):
        file = with_usual(file, name)
    return file


def _said(
    search: Search,
    found: Verdict,
    effects: tuple[Named, ...],
    handed: Predicted,
    shapes: Mapping[str, Shape],
) -> Verdict:
    """The verdict with the names that stand and the values that are handed over."""
    valued = tuple(_valued(effect, handed) for effect in effects)
    if valued:
        return replace(found, effects=valued)
    if found.effects or (found.kind == "nothing_missing" and handed.added):
        return unnamed(search, shapes)
    return found


def _valued(effect: Named, handed: Predicted) -> Named:
    values, bound = intervals(handed.fitted, effect.name)
    return replace(effect, parameters=values, at_bound=bound)
