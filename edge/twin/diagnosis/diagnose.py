"""The whole workflow: locate, name, tell rivals apart, add and show."""

import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from edge.twin.diagnosis.adopted_twin import Added, Origin, twin_after
from edge.twin.diagnosis.candidates import Scored
from edge.twin.diagnosis.formulas import formulas
from edge.twin.diagnosis.gap import Forecast, alone, errors, floor_squares, forecast
from edge.twin.diagnosis.given import Given, given, with_rooms
from edge.twin.diagnosis.held_out import held_out_gains
from edge.twin.diagnosis.innovations import NoiseLevels
from edge.twin.diagnosis.progress import Progress
from edge.twin.diagnosis.runs import DiagnosisRuns, NamedRun
from edge.twin.diagnosis.search import Search
from edge.twin.diagnosis.side_by_side import SideBySide
from edge.twin.diagnosis.verdict import Verdict, interval, verdict
from edge.twin.effects import EFFECTS
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """A twin, its noise, and its free runs over the training and the test runs."""

    file: TwinFile
    levels: NoiseLevels
    train: tuple[Forecast, ...]
    test: tuple[Forecast, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """All that was found, before it is written.

    steps : the gap's waterfall, the effects of each and its twin, the first as given
    """

    data: DiagnosisRuns
    known: Given
    search: Search
    verdict: Verdict
    before: Side
    after: Side
    steps: tuple[tuple[tuple[str, ...], Side], ...]
    floor_k: tuple[float | None, float | None]
    adopted: TwinFile
    seconds: float


def diagnose(
    file: TwinFile, data: DiagnosisRuns, progress: Progress, command: str, jobs: int = 1
) -> Diagnosis:
    """From a twin and runs to what it lacks.

    jobs : processes, which change the time and not the answer
    Errors : DataError for runs that the twin can't be fitted to
    """
    begun = time.monotonic()
    progress("reading the runs, looking for doors and wrong readings")
    prepared = given(file, data)
    with SideBySide(jobs, prepared.runs.temp.size) as shared:
        return _diagnosis(prepared, data, progress, command, shared, begun)


def _diagnosis(
    prepared: Given,
    data: DiagnosisRuns,
    progress: Progress,
    command: str,
    shared: SideBySide,
    begun: float,
) -> Diagnosis:
    shapes = formulas(prepared.runs, prepared.expected, prepared.file.sample_s)
    terms = {name: term for name, (_, term) in shapes.items()}
    search = Search(
        prepared.file, prepared.runs, progress, prepared.terms, terms, len(prepared.doors), shared=shared
    )
    found = verdict(search, {name: shape for name, (shape, _) in shapes.items()})
    known = with_rooms(prepared, found.final.fitted.sizes)
    progress("free runs before and after")
    names = tuple(effect.name for effect in found.effects)
    search.held_out |= held_out_gains(search, found.final, names)
    before = _before(prepared, search.sets.base(), data)
    steps: list[tuple[tuple[str, ...], Side]] = [((), before)]
    for count in range(1, len(names) + 1):
        item = _only(search, found, names[:count])
        twin = _settled(prepared.file, item, names[:count])
        own = with_rooms(prepared, item.fitted.sizes)
        steps.append((names[:count], _side(twin, item.fitted.trial.levels, data, own)))
    after = steps[-1][1]
    train = known.as_fitted()
    floor = (_floor_k(after, train, after.train, known), _floor_k(after, data.test, after.test, known))
    origin = Origin(
        data.data_sha256,
        {"train": _rounded(errors(before.train)), "test": _rounded(errors(before.test))},
        {"train": _rounded(errors(after.train)), "test": _rounded(errors(after.test))},
        datetime.now(UTC).isoformat(timespec="seconds"),
        command,
    )
    return Diagnosis(
        data,
        known,
        search,
        found,
        before,
        after,
        tuple(steps),
        floor,
        _adopted(prepared.file, search, found, names, origin),
        time.monotonic() - begun,
    )


def _before(prepared: Given, base: Scored, data: DiagnosisRuns) -> Side:
    """The twin as given; what it leaves open is as the file has them or fitted, whichever is better."""
    levels, file = base.fitted.trial.levels, prepared.file
    given_side = _side(file, levels, data, with_rooms(prepared, base.fitted.sizes))
    is_open = {place for place, value in file.values().items() if value.fit}
    if not is_open:
        return given_side
    values = base.fitted.file.values()
    fitted = file.with_values({place: Value(values[place].value) for place in is_open})
    fitted_side = _side(fitted, levels, data, with_rooms(prepared, base.fitted.sizes))
    return min(given_side, fitted_side, key=_train_rmse_k)


def _train_rmse_k(side: Side) -> float:
    found = errors(side.train)
    return np.inf if found is None else float(str(found["rmse_k"]))


def _only(search: Search, found: Verdict, names: tuple[str, ...]) -> Scored:
    """The final set with no more than these effects."""
    item = found.final
    for name in sorted(item.added - set(names)):
        item = search.sets.without(item, name)
    return item


def _side(file: TwinFile, levels: NoiseLevels, data: DiagnosisRuns, known: Given) -> Side:
    twin = file.twin()

    def of(named: NamedRun) -> Forecast:
        return forecast(twin, named, known.room_of(named))

    train, test = known.as_fitted(), data.test
    return Side(file, levels, tuple(of(item) for item in train), tuple(of(item) for item in test))


def _floor_k(
    side: Side, runs: tuple[NamedRun, ...], free: tuple[Forecast, ...], known: Given
) -> float | None:
    """What a right twin's free runs would miss by, over the rows behind their starts."""
    twin, squares = side.file.twin(), []
    for named, guess in zip(runs, free, strict=True):
        seen = np.isfinite(guess.measured)
        seen[: guess.start + 1] = False
        if seen.any():
            single = alone(named, guess, known.room_of(named))
            squares.append(floor_squares(twin, side.levels, single, seen))
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else None


def _settled(file: TwinFile, item: Scored, names: tuple[str, ...]) -> TwinFile:
    """The twin with the set's values, without what its effects replace."""
    fitted = item.fitted.file
    values = {place: Value(value.value) for place, value in fitted.values().items()}
    plain = fitted.with_values(values)
    gone = _replaced(names)
    return replace(plain, effects={name: own for name, own in plain.effects.items() if name not in gone})


def _replaced(names: tuple[str, ...]) -> set[str]:
    return {EFFECTS[name].replaces for name in names} - {""}


def _adopted(
    file: TwinFile, search: Search, found: Verdict, names: tuple[str, ...], origin: Origin
) -> TwinFile:
    """The twin file to adopt: effects with intervals, and what the runs say of the values that were open."""
    item = _only(search, found, names)
    gone = _replaced(names)
    kept = replace(file, effects={name: own for name, own in file.effects.items() if name not in gone})
    refitted: dict[Place, Value] = {}
    for i, unknown in enumerate(item.fitted.free):
        if unknown.place in kept.values():
            value = interval(unknown, float(item.fitted.coordinates[i]), float(item.fitted.covariance[i, i]))
            refitted[unknown.place] = value
    added = [
        Added(effect.name, effect.parameters, tuple(effect.alternatives), effect.log_odds)
        for effect in found.effects
    ]
    return twin_after(kept, added, origin, refitted)


def _rounded(found: dict[str, object] | None) -> dict[str, object] | None:
    return None if found is None else {key: found[key] for key in ("rmse_k", "mae_k")}
