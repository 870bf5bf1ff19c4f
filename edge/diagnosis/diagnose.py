"""The whole workflow: locate, name, tell rivals apart, add and show."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.adopted_twin import AddedEffect, Origin, plain_value, round_value, twin_after
from edge.diagnosis.baselines import ONE_MASS, arx_errors
from edge.diagnosis.diagnosis_document import GapErrors
from edge.diagnosis.formulas import formulas
from edge.diagnosis.gap import RunForecast, alone, errors, floor_squares, forecast, one_step
from edge.diagnosis.handover import OPEN, against_adopting
from edge.diagnosis.innovations import NoiseLevels
from edge.diagnosis.judgement import DiagnosisJudgement, judge
from edge.diagnosis.prepare import PreparedRuns, errors_over, prepare, with_rooms
from edge.diagnosis.progress import Progress, Stage
from edge.diagnosis.runs import DiagnosisRuns, NamedRun
from edge.diagnosis.search import Search
from edge.diagnosis.side_by_side import SideBySide
from edge.diagnosis.trial import FittedTwin
from edge.diagnosis.verdict import DiagnosisVerdict, interval, intervals, verdict
from edge.twin.draws import CORRELATION, correlation_document
from edge.twin.effects.library import EFFECTS
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]
# Shares of the time, and steps, as cases of bench/foreign took them.
SEARCHED, JUDGED = (0.05, 0.3, 10.0), (0.3, 0.95, 3.0)


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """A twin, its noise, and its free runs over the training and the test runs."""

    file: TwinFile
    levels: NoiseLevels
    train: tuple[RunForecast, ...]
    test: tuple[RunForecast, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """All that was found, before it is written.

    steps : the gap's waterfall, the effects of each and its twin, the first as given
    against_adopting : why the twin that was found should not be adopted, sentences
    test_k : errors of free runs over the test runs, `before`, `after` and of each baseline; empty without any
    one_step : each test run predicted a row ahead by the twin after, [rows] [°C]
    """

    data: DiagnosisRuns
    inputs: PreparedRuns
    search: Search
    judgement: DiagnosisJudgement
    before: Side
    after: Side
    steps: tuple[tuple[tuple[str, ...], Side], ...]
    floor_k: tuple[float | None, float | None]
    adopted: TwinFile
    against_adopting: tuple[str, ...]
    test_k: Mapping[str, float]
    one_step: tuple[Floats, ...]
    seconds: float

    @property
    def is_offered(self) -> bool:
        """True if there is a new twin that is worth adopting."""
        return bool(self.judgement.handover.added) and not self.against_adopting

    @property
    def verdict(self) -> DiagnosisVerdict:
        """The names that stand."""
        return self.judgement.verdict

    @property
    def simple_twins(self) -> dict[str, TwinFile]:
        """The fitted baselines that are twins, by name; of their provenance the correlations alone."""
        return {name: _fitted_twin(item.fit) for name, item in self.judgement.comparison.simple.items()}


def _fitted_twin(item: FittedTwin) -> TwinFile:
    known = {place: Value(round_value(value.value)) for place, value in item.file.values().items()}
    fitted = {place: plain_value(value) for place, value in _free_values(item).items()}
    return replace(item.file.with_values(known | fitted), provenance=_correlation(item))


def diagnose(
    file: TwinFile, data: DiagnosisRuns, progress: Progress, command: str, jobs: int = 1
) -> Diagnosis:
    """From a twin and runs to what it lacks.

    jobs : processes, which change the time and not the answer
    Errors : DataError for runs that the twin can't be fitted to
    """
    begun = time.monotonic()
    progress("reading the runs, looking for doors and wrong readings", 0.0)
    prepared = prepare(file, data)
    with SideBySide(jobs, prepared.runs.temp.size) as shared:
        return _diagnosis(prepared, data, progress, command, shared, begun)


def _diagnosis(
    prepared: PreparedRuns,
    data: DiagnosisRuns,
    progress: Progress,
    command: str,
    shared: SideBySide,
    begun: float,
) -> Diagnosis:
    shapes = formulas(
        prepared.runs,
        prepared.expected,
        prepared.file.sample_s,
        prepared.file.geometry["heater_max_w"].value,
    )
    # Formulas stand in the same search as effects, so that both are judged by one rule.
    terms = {name: term for name, (_, term) in shapes.items()}
    search = Search(
        prepared.file,
        prepared.runs,
        Stage(progress, *SEARCHED),
        prepared.terms,
        terms,
        len(prepared.doors),
        pool=shared,
    )
    text_shapes = {name: shape for name, (shape, _) in shapes.items()}
    found = verdict(search, text_shapes)
    judging = Stage(progress, *JUDGED)
    result = judge(search, found, prepared, text_shapes, shared, judging, data.test)
    progress("free runs before and after", JUDGED[1])
    known = with_rooms(prepared, found.final.fit.sizes)
    steps = tuple(_steps(search, result, prepared, data))
    before, after = steps[0][1], steps[-1][1]
    train = known.as_fitted()
    floor = (_floor_k(after, train, after.train, known), _floor_k(after, data.test, after.test, known))
    origin = Origin(
        data.data_sha256,
        {"train": _round_errors(errors(before.train)), "test": _round_errors(errors(before.test))},
        {"train": _round_errors(errors(after.train)), "test": _round_errors(errors(after.test))},
        datetime.now(UTC).isoformat(timespec="seconds"),
        command,
        {"validity": _validity(known)},
    )
    test_k = _test_k(result, prepared, data, before, after)
    return Diagnosis(
        data,
        known,
        search,
        result,
        before,
        after,
        steps,
        floor,
        _adopt(prepared.file, result, origin),
        against_adopting(
            result.comparison.trials[frozenset()], result.handover, result.comparison.simple_k, test_k
        ),
        test_k,
        tuple(_one_step(after, *pair, known) for pair in zip(data.test, after.test, strict=True)),
        time.monotonic() - begun,
    )


def _validity(known: PreparedRuns) -> dict[str, object]:
    """Return the range of what the twin was fitted to, and the length of the longest run."""
    runs = known.runs
    rows = int(np.isfinite(runs.temp).sum(axis=1).max())
    return {
        "temp_air_c": [np.nanmin(runs.temp), np.nanmax(runs.temp)],
        "temp_ambient_c": [np.nanmin(runs.ambient), np.nanmax(runs.ambient)],
        "hours": rows * known.file.sample_s / 3600.0,
    }


def _steps(
    search: Search, result: DiagnosisJudgement, prepared: PreparedRuns, data: DiagnosisRuns
) -> Iterator[tuple[tuple[str, ...], Side]]:
    """One effect after another, names first, each twin with the values that predict."""
    names = [item.name for item in result.verdict.effects]
    sets = [(tuple(names[:count]), frozenset(names[:count])) for count in range(len(names) + 1)]
    if result.handover.added != sets[-1][1]:
        sets.append(((*names, *result.provisional), result.handover.added))
    beside = search.sets.base()
    for added, key in sets:
        item = result.comparison.trials[key].fit
        wanted = key - {OPEN}
        beside = search.sets.fit({wanted: search.sets.as_usual(beside, wanted)})[0]
        own = with_rooms(prepared, item.sizes)
        yield added, _side(_settle(item.file, added), beside.fit.trial.levels, data, own)


def _test_k(
    result: DiagnosisJudgement, prepared: PreparedRuns, data: DiagnosisRuns, before: Side, after: Side
) -> dict[str, float]:
    """Errors over the test runs of the twin before and after and of each baseline; none without test runs."""
    found = {"before": _errors(before.test), "after": _errors(after.test)}
    for name, item in result.comparison.simple.items():
        found[name] = [errors_over(data.test, item.fit, prepared)]
    rooms = with_rooms(prepared, result.comparison.simple[ONE_MASS].fit.sizes)
    for name, arx in result.comparison.arx.items():
        found[name] = [
            _arx_errors(arx.weights, run, guess, rooms.room_of(run))
            for run, guess in zip(data.test, before.test, strict=True)
        ]
    missed = {name: np.concatenate([np.empty(0), *errors]) for name, errors in found.items()}
    known = {name: errors[~np.isnan(errors)] for name, errors in missed.items()}
    return {name: float(np.sqrt(np.mean(errors**2))) for name, errors in known.items() if len(errors)}


def _errors(free: Sequence[RunForecast]) -> list[Floats]:
    return [item.residual for item in free]


def _arx_errors(weights: Floats | None, run: NamedRun, guess: RunForecast, room_c: Floats) -> Floats:
    """From the row on that a twin begins from."""
    arrays = alone(run, guess, room_c)
    seen = np.zeros(arrays.duty.shape, dtype=bool)
    seen[:, : guess.start] = True
    missed = arx_errors(weights, arrays, seen)[0, guess.start :]
    return np.where(np.isfinite(guess.measured[guess.start + 1 :]), missed, np.nan)


def _side(file: TwinFile, levels: NoiseLevels, data: DiagnosisRuns, known: PreparedRuns) -> Side:
    twin = file.twin()

    def of(named: NamedRun) -> RunForecast:
        return forecast(twin, named, known.room_of(named))

    train, test = known.as_fitted(), data.test
    return Side(file, levels, tuple(of(item) for item in train), tuple(of(item) for item in test))


def _one_step(side: Side, named: NamedRun, guess: RunForecast, known: PreparedRuns) -> Floats:
    single = alone(named, guess, known.room_of(named))
    return one_step(side.file.twin(), side.levels, single, np.isfinite(guess.measured))


def _floor_k(
    side: Side, runs: tuple[NamedRun, ...], free: tuple[RunForecast, ...], known: PreparedRuns
) -> float | None:
    """Return the error that free runs of a correct twin would have, over the rows behind their starts [K]."""
    twin, squares = side.file.twin(), []
    for named, guess in zip(runs, free, strict=True):
        seen = np.isfinite(guess.measured)
        seen[: guess.start + 1] = False
        if seen.any():
            single = alone(named, guess, known.room_of(named))
            squares.append(floor_squares(twin, side.levels, single, seen))
    if not squares:
        return None
    floor_k = float(np.sqrt(np.mean(np.concatenate(squares))))
    # Heat that noise was taken for may be more than what is left: no twin is below its floor.
    found = errors(free)
    least_k = found["rmse_k"] if found else None
    return floor_k if least_k is None else min(floor_k, least_k)


def _settle(fitted: TwinFile, names: Sequence[str]) -> TwinFile:
    """Return the twin with its values as known ones, without the effects that the new ones replace."""
    plain = fitted.with_values({place: Value(value.value) for place, value in fitted.values().items()})
    gone = _replaced_names(names)
    return replace(plain, effects={name: own for name, own in plain.effects.items() if name not in gone})


def _replaced_names(names: Iterable[str]) -> set[str]:
    return {EFFECTS[name].replaces for name in names} - {""}


def _adopt(file: TwinFile, result: DiagnosisJudgement, origin: Origin) -> TwinFile:
    """Return the twin file to adopt: new effects with intervals, and fitted
    values in the place of open ones.
    """
    fitted, names = result.handover.fit, result.handover.added - {OPEN}
    gone = _replaced_names(names)
    kept = replace(file, effects={name: own for name, own in file.effects.items() if name not in gone})
    there = kept.values()
    refitted = {place: value for place, value in _free_values(fitted).items() if place in there}
    added = [
        AddedEffect(effect.name, effect.parameters, tuple(effect.alternatives), effect.log_odds)
        for effect in result.verdict.effects
    ]
    added += [AddedEffect(name, intervals(fitted, name)[0]) for name in result.provisional]
    origin = replace(origin, further={**origin.further, **_correlation(fitted)})
    return twin_after(kept, added, origin, refitted)


def _free_values(fitted: FittedTwin) -> dict[Place, Value]:
    """Return what a fit has moved, with 95 % intervals."""
    return {
        unknown.place: interval(unknown, float(x), float(variance))
        for unknown, x, variance in zip(
            fitted.free, fitted.coordinates, np.diag(fitted.covariance), strict=False
        )
    }


def _correlation(fitted: FittedTwin) -> dict[str, object]:
    places = [unknown.place for unknown in fitted.free]
    return {CORRELATION: correlation_document(places, fitted.covariance)} if places else {}


def _round_errors(found: GapErrors | None) -> dict[str, object] | None:
    return None if found is None else {"rmse_k": found["rmse_k"], "mae_k": found["mae_k"]}
