"""The whole workflow: fit, grow, judge, and show the gap before and after."""

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.adopted_twin import AddedEffect, Origin, plain_value, round_value, twin_after
from edge.diagnosis.baselines import ONE_MASS, ORDERS, arx_errors, arx_weights, open_file, simple_sets
from edge.diagnosis.diagnosis_document import GapErrors
from edge.diagnosis.events import DOOR, DoorOpening, with_events
from edge.diagnosis.gap import RunForecast, columns_of, errors, forecasts
from edge.diagnosis.judge import DiagnosisVerdict, interval, judge, values_of
from edge.diagnosis.prepare import PreparedRuns, prepare
from edge.diagnosis.progress import Progress, Stage, Telling
from edge.diagnosis.runs import DiagnosisRuns, NamedRun
from edge.diagnosis.seeds import seeds
from edge.diagnosis.twin_choice import (
    MOST_ADDED,
    OPEN,
    Names,
    TriedTwin,
    TwinChoice,
    block_squares,
    candidates_of,
    folds_of,
)
from edge.diagnosis.twin_fit import FittedTwin, begun
from edge.twin.draws import CORRELATION, correlation_document
from edge.twin.effects.library import EFFECTS
from edge.twin.run_batch import RunBatch
from edge.twin.twin_file import Place, TwinFile
from edge.twin.value import Value

Floats = NDArray[np.float64]
PREPARED, SEARCHED = (0.02, 0.2, 10.0), (0.2, 0.9, 6.0)  # shares of the time, and steps
NO_WORSE = 1.05  # times the error of the best simple model: less is no difference
LOOKS = 3  # for doors
FAR_WORSE = 1.25  # times the error of an ARX, which is not a twin: less is no reason to have none
OPENED = next(name for name, effect in EFFECTS.items() if DOOR in effect.offered_with)


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """A twin, and its free runs over the training and the test runs."""

    fit: FittedTwin
    train: tuple[RunForecast, ...]
    test: tuple[RunForecast, ...]

    @property
    def file(self) -> TwinFile:
        """With the values that it runs with."""
        return _as_known(self.fit.file)


@dataclass(frozen=True, slots=True, eq=False)
class Baselines:
    """Simple models. left_out_k : errors over left-out rows; test_k : over test runs, none without any [K]"""

    twins: Mapping[str, TriedTwin]
    left_out_k: Mapping[str, float]
    test_k: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """All that was found, before it is written.

    steps : the gap's waterfall, the effects of each and its twin, the first as given
    against_adopting : why the twin that was found should not be adopted, sentences
    """

    data: DiagnosisRuns
    inputs: PreparedRuns
    doors: tuple[DoorOpening, ...]
    choice: TwinChoice
    verdict: DiagnosisVerdict
    steps: tuple[tuple[tuple[str, ...], Side], ...]
    baselines: Baselines
    adopted: TwinFile
    against_adopting: tuple[str, ...]
    seconds: float

    @property
    def before(self) -> Side:
        """The twin as given, with what it leaves open fitted."""
        return self.steps[0][1]

    @property
    def after(self) -> Side:
        """The twin that is handed over."""
        return self.steps[-1][1]

    @property
    def is_offered(self) -> bool:
        """True if there is a new twin that is worth adopting."""
        return bool(self.verdict.handed.added) and not self.against_adopting

    @property
    def test_k(self) -> dict[str, float]:
        """Errors over the test runs, `before`, `after` and of each baseline; none without test runs [K]."""
        found = {}
        for name, side in (("before", self.before), ("after", self.after)):
            if (own := errors(side.test)) is not None:
                found[name] = float(own["rmse_k"] or 0.0)
        return found | dict(self.baselines.test_k) if found else {}

    @property
    def simple_twins(self) -> dict[str, TwinFile]:
        """The fitted baselines that are twins, by name; of their provenance the correlations alone."""
        return {
            name: _at_step(_known_twin(item.fit), self.inputs.given)
            for name, item in self.baselines.twins.items()
        }


class _Opened(NamedTuple):
    """Runs as `with_events` leaves them, and the twin fitted to them; None without doors."""

    cleaned: PreparedRuns
    doors: tuple[DoorOpening, ...]
    twin: TriedTwin | None

    @property
    def left_out_k(self) -> float:
        """Error of the twin over left-out rows, infinite without one [K]."""
        return np.inf if self.twin is None else self.twin.left_out_k


def diagnose(file: TwinFile, data: DiagnosisRuns, progress: Progress, command: str) -> Diagnosis:
    """From a twin and runs to what it lacks. Errors: DataError for runs that the twin can't be fitted to"""
    begun_s = time.monotonic()
    prepared = prepare(file, data, Stage(progress, *PREPARED))
    telling = Stage(progress, *SEARCHED)
    choice = _choice(prepared, telling)
    names = choice.grow(seeds(choice.file, choice.runs))
    telling("doors and wrong readings")
    prepared, choice, names, doors = _with_events(prepared, choice, names, telling)
    telling("what has no name")
    handed = choice.close_gap(names)
    choice.attempt_from(handed, [handed - {name} for name in names])
    found = judge(choice, names, handed, {OPENED} if doors else frozenset())
    progress("free runs before and after", SEARCHED[1])
    steps = tuple(_steps(choice, found, prepared, data))
    baselines = _baselines(prepared, data, choice.file)
    after = steps[-1][1]
    origin = Origin(
        data.data_sha256,
        {"train": _round_errors(errors(steps[0][1].train)), "test": _round_errors(errors(steps[0][1].test))},
        {"train": _round_errors(errors(after.train)), "test": _round_errors(errors(after.test))},
        datetime.now(UTC).isoformat(timespec="seconds"),
        command,
        {"validity": _validity(prepared)},
    )
    result = Diagnosis(
        data, prepared, doors, choice, found, steps, baselines, _adopt(prepared, found, origin), (),
        time.monotonic() - begun_s,
    )  # fmt: skip
    return replace(result, against_adopting=_against(result))


def _with_events(
    given: PreparedRuns, choice: TwinChoice, names: Names, telling: Telling
) -> tuple[PreparedRuns, TwinChoice, Names, tuple[DoorOpening, ...]]:
    """Return the runs without wrong readings and with doors found in them, what is chosen, and the doors.

    What a twin lacks can hide behind doors, and doors behind that: they are also sought by twins with what
    most boxes have. A twin that knows more tells better when a door was open, and for how much of a row.
    """
    more = [names | {name} for name in choice.usual if len(names | {name}) < MOST_ADDED]
    sets = list(dict.fromkeys([names, *more]))
    choice.attempt_from(names, sets)
    found = [_with_doors(given, choice.tried[key], telling) for key in sets]
    best = min(found, key=lambda item: item.left_out_k)
    if (twin := best.twin) is None:
        cleaned = found[0].cleaned
        if cleaned is given:
            return given, choice, names, ()
        again = _choice(cleaned, telling)
        again.attempt([(names, choice.tried[names].fit)])
        return cleaned, again, again.grow(), ()
    for _ in range(LOOKS):
        now = _with_doors(given, twin, telling)
        if now.twin is None or now.left_out_k >= best.left_out_k:
            break
        best, twin = now, now.twin
    again = _choice(best.cleaned, telling)
    again.attempt([(names, choice.tried[names].fit), (twin.added, twin.fit)])
    then = again.grow()
    # Otherwise nothing is forecast better with them.
    return (best.cleaned, again, then, best.doors) if OPENED in then else (given, choice, names, ())


def _with_doors(given: PreparedRuns, known: TriedTwin, telling: Telling) -> _Opened:
    """Return the runs with the doors that a twin finds, and the twin fitted to them."""
    kept = {name: own for name, own in known.fit.file.effects.items() if name != OPENED}
    shut = replace(known.fit, file=replace(known.fit.file, effects=kept))
    cleaned, doors = with_events(given, shut)
    names = known.added | {OPENED}
    if not doors or len(names) > MOST_ADDED:
        return _Opened(cleaned, doors, None)
    wide = float(np.median([door.conductance_w_k for door in doors]))
    values = {item.name: Value(wide, fit=True) for item in EFFECTS[OPENED].parameters}
    choice = _choice(cleaned, telling)
    choice.attempt([(names, begun(replace(shut.file, effects={**kept, OPENED: values})))])
    return _Opened(cleaned, doors, choice.tried[names])


def _choice(known: PreparedRuns, telling: Telling) -> TwinChoice:
    """Return a choice among all candidates over runs, before anything is tried."""
    runs = known.fit_runs
    return TwinChoice(known.file, runs, candidates_of(known.file, runs), telling)


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
    choice: TwinChoice, found: DiagnosisVerdict, prepared: PreparedRuns, data: DiagnosisRuns
) -> Iterator[tuple[tuple[str, ...], Side]]:
    """Yield the twin with one effect after another, names first, and at last the one that is handed over."""
    names = [item.name for item in found.effects]
    sets = [tuple(names[:count]) for count in range(len(names) + 1)]
    if frozenset(sets[-1]) != found.handed.added:
        sets.append((*names, *found.provisional))
    choice.attempt_from(found.handed.added, [frozenset(own) for own in sets])
    for own in sets:
        fit = choice.tried[frozenset(own)].fit
        yield own, Side(fit, *(forecasts(fit, runs, prepared) for runs in (prepared.train, data.test)))


def _baselines(prepared: PreparedRuns, data: DiagnosisRuns, file: TwinFile) -> Baselines:
    """Fit the simple models to the same rows."""
    runs = prepared.fit_runs
    choice = TwinChoice(open_file(file, prepared.runs), runs, ())
    choice.attempt([(frozenset(), begun(choice.file))])
    sets = simple_sets()
    choice.screen(filter(None, sets.values()), frozenset())
    choice.attempt((names, fit) for names, (fit, _) in choice.screened.items())
    twins = {name: choice.tried[names] for name, names in sets.items()}
    left_out = {name: item.left_out_k for name, item in twins.items()}
    tests: dict[str, float] = {}
    for name, item in twins.items():
        if (own := errors(forecasts(item.fit, data.test, prepared))) is not None:
            tests[name] = float(own["rmse_k"] or 0.0)
    batch, folds = prepared.runs, folds_of(runs)
    test_runs = forecasts(twins[ONE_MASS].fit, data.test, prepared)
    for order in ORDERS:
        missed = np.full(runs.seen.shape, np.nan)
        for mask, judged in folds:
            weights = arx_weights(order, batch, mask & runs.seen)
            rows = judged & runs.seen
            missed[rows] = arx_errors(weights, batch, _begun_rows(mask, order))[rows]
        left_out[f"ARX {order}"] = float(np.sqrt(np.mean(block_squares(missed, folds)[0])))
        if tests:
            weights = arx_weights(order, batch, runs.seen)
            known = np.concatenate(
                [_arx_test(weights, order, *pair) for pair in zip(test_runs, data.test, strict=True)]
            )
            known = known[~np.isnan(known)]  # where nothing was measured
            with np.errstate(over="ignore"):  # of one that runs away
                tests[f"ARX {order}"] = float(np.sqrt(np.mean(known**2))) if len(known) else np.inf
    return Baselines(twins, left_out, tests)


def _begun_rows(mask: NDArray[np.bool_], order: int) -> NDArray[np.bool_]:
    """Return the rows that an ARX may know: those that were fitted, and as many as it needs to begin."""
    seen = mask.copy()
    seen[:, :order] = True
    return seen


def _arx_test(weights: Floats | None, order: int, guess: RunForecast, named: NamedRun) -> Floats:
    """Return an ARX model's errors over a test run, from the row on that a twin is judged from."""
    first = int(np.isfinite(guess.measured).argmax())
    inputs = columns_of(named.run, guess.room_c)
    duty, fan, room = (inputs[name][None, first:-1] for name in ("heater_duty", "fan_on", "temp_ambient"))
    begin = max(guess.start - first, order)
    seen = np.zeros(duty.shape, dtype=bool)
    seen[:, :begin] = True
    batch = RunBatch(guess.measured[None, first:], duty, fan, room)
    return np.asarray(arx_errors(weights, batch, seen)[0, begin:])


def _as_known(fitted: TwinFile) -> TwinFile:
    """Return a twin with its values as known ones, without the effects that others replace."""
    plain = fitted.with_values({place: Value(value.value) for place, value in fitted.values().items()})
    gone = _replaced_names(plain.effects)
    return replace(plain, effects={name: own for name, own in plain.effects.items() if name not in gone})


def _replaced_names(names: Iterable[str]) -> set[str]:
    return {EFFECTS[name].replaces for name in names} - {""}


def _adopt(prepared: PreparedRuns, found: DiagnosisVerdict, origin: Origin) -> TwinFile:
    """Return the twin file to adopt: new effects with intervals, and fitted values in place of open ones."""
    fit, names = found.handed.fit, found.handed.added - {OPEN}
    gone = _replaced_names(names)
    file = prepared.file
    kept = replace(file, effects={name: own for name, own in file.effects.items() if name not in gone})
    there = kept.values()
    refitted = {place: value for place, value in _free_values(fit).items() if place in there}
    added = [
        AddedEffect(item.name, item.parameters, tuple(item.alternatives), item.log_odds)
        for item in found.effects
    ]
    added += [AddedEffect(name, values_of(fit, name)) for name in found.provisional if name != OPEN]
    origin = replace(origin, further={**origin.further, **_correlation(fit)})
    return _at_step(twin_after(kept, added, origin, refitted), prepared.given)


def _at_step(file: TwinFile, given: TwinFile) -> TwinFile:
    """Return a twin at the step that it was given with."""
    return replace(file, sample_s=given.sample_s)


def _known_twin(fit: FittedTwin) -> TwinFile:
    known = {place: Value(round_value(value.value)) for place, value in fit.file.values().items()}
    fitted = {place: plain_value(value) for place, value in _free_values(fit).items()}
    return replace(fit.file.with_values(known | fitted), provenance=_correlation(fit))


def _free_values(fit: FittedTwin) -> dict[Place, Value]:
    """Return what a fit has moved, with 95 % intervals."""
    pairs = zip(fit.free, fit.x, np.diag(fit.covariance), strict=True)
    return {item.place: interval(item, float(x), float(variance)) for item, x, variance in pairs}


def _correlation(fit: FittedTwin) -> dict[str, object]:
    places = [item.place for item in fit.free]
    return {CORRELATION: correlation_document(places, fit.covariance)} if places else {}


def _round_errors(found: GapErrors | None) -> dict[str, object] | None:
    return None if found is None else {"rmse_k": found["rmse_k"], "mae_k": found["mae_k"]}


def _against(found: Diagnosis) -> tuple[str, ...]:
    """Why the twin that was found should not be adopted, sentences; none where it may."""
    given, handed, said = found.choice.tried[frozenset()], found.verdict.handed, []
    own_k, test_k = handed.left_out_k, found.test_k
    # `not a < b`, not `a >= b`: an error that is no number speaks against it too.
    if not own_k < given.left_out_k:
        said.append(
            f"over left-out rows its free runs miss by {own_k:.3g} K, those of the twin as given by "
            f"{given.left_out_k:.3g} K"
        )
    if test_k and not test_k["after"] < test_k["before"]:
        said.append(
            f"over the test runs its free runs miss by {test_k['after']:.3g} K, before by "
            f"{test_k['before']:.3g} K"
        )
    return (*said, *_simpler(found))


def _simpler(found: Diagnosis) -> Iterator[str]:
    """Yield the best simple model where it predicts better than the twin that was found.

    An ARX is no twin: only if it is far better over all rows that no fit saw is it the answer.
    """
    own_k, left_out_k = found.verdict.handed.left_out_k, found.baselines.left_out_k
    twin = min(found.baselines.twins, key=left_out_k.__getitem__)
    if not own_k <= NO_WORSE * left_out_k[twin]:
        yield f"over left-out rows {twin} misses by {left_out_k[twin]:.3g} K, this twin by {own_k:.3g} K"
    arx = min(left_out_k.keys() - found.baselines.twins.keys(), key=left_out_k.__getitem__)
    tests = found.test_k
    if own_k > FAR_WORSE * left_out_k[arx] and (not tests or tests["after"] > FAR_WORSE * tests[arx]):
        yield (
            f"no twin follows this box as well as {arx} does, which misses left-out rows by "
            f"{left_out_k[arx]:.3g} K, this twin by {own_k:.3g} K; run MPC-P, whose predictor is one"
        )
