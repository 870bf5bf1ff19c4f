"""Recordings of a diagnosis: read, checked, cut into pieces and resampled to the step of the twin.

Two sensors in the air become one, their mean.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.diagnosis.cannot_tell import cannot_tell
from edge.diagnosis.readings import plausible_run
from edge.formats.number_table import read_table
from edge.formats.run_file import RecordedRun, cut, data_sha256, refuse_test, resample
from edge.twin.run_batch import CONDITIONS
from edge.twin.twin_file import TwinFile

GAP_S = 600.0  # without rows for longer, nothing is known of what the heater did meanwhile
WHOLE_S = 48 * 3600.0  # in steps of a minute: what is no longer stays one, as long as its steps are slower
LONGEST_S = 24 * 3600.0  # of the parts of what is longer, as time grows with the longest of them
USUAL_STEP_S = 60.0


def pieces(run: RecordedRun, step_s: float = USUAL_STEP_S) -> list[RecordedRun]:
    """Cut a run where rows are more than GAP_S apart, and cut what is longer than WHOLE_S into equal parts.

    What a body had stored is not known where a part begins.

    step_s : of the twin; where it is more than a minute, gaps and parts may be longer by as much
    Each piece begins at time 0 and says when that was. No row is in two of them.
    """
    slower = max(1.0, step_s / USUAL_STEP_S)
    time_s = run.columns["time_s"]
    starts = [0, *(np.flatnonzero(np.diff(time_s) > GAP_S * slower) + 1).tolist(), len(time_s)]
    found = []
    for begin, end in pairwise(starts):
        lasts_s = (time_s[end - 1] - time_s[begin]) / slower
        parts = 1 if lasts_s <= WHOLE_S else math.ceil(lasts_s / LONGEST_S)
        bounds = np.linspace(begin, end, parts + 1).round().astype(int)
        found += [cut(run, int(first), int(last)) for first, last in pairwise(bounds)]
    return [piece for piece in found if len(piece)]


SECOND = "temp_air_second_c"
MUCH_K = 0.5  # farther apart while it heats than while it does not: more than two sensors of one air

Named = tuple[str, RecordedRun]


def average(train: Sequence[Named], test: Sequence[Named]) -> tuple[list[Named], list[Named], list[str]]:
    """Return the recordings with the mean of both air sensors as their air, and sentences that say
    so. Runs without both sensors in every file stay as they are.
    """
    every = [*train, *test]
    with_second = [run for _, run in every if np.isfinite(_apart(run)).any()]
    if not with_second:
        return list(train), list(test), []
    if len(with_second) < len(every):
        return list(train), list(test), [f"{SECOND} is not known in every run and is passed over"]
    return (
        [(name, _mean(run)) for name, run in train],
        [(name, _mean(run)) for name, run in test],
        [_note([run for _, run in train])],
    )


def _apart(run: RecordedRun) -> np.ndarray:
    return np.asarray(run.columns.get(SECOND, np.full(len(run), np.nan)) - run.columns["temp_air_c"])


def _mean(run: RecordedRun) -> RecordedRun:
    """Return a run with the mean of both sensors. Where one has no reading, the other
    replaces it, shifted by their usual difference.
    """
    first, second, apart = run.columns["temp_air_c"], run.columns[SECOND], _apart(run)
    half_k = 0.5 * float(np.nanmedian(apart))
    either = np.where(np.isfinite(first), first + half_k, second - half_k)
    air = np.where(np.isfinite(apart), 0.5 * (first + second), either)
    kept = {key: values for key, values in run.columns.items() if key != SECOND}
    return replace(run, columns={**kept, "temp_air_c": air})


def _note(runs: Sequence[RecordedRun]) -> str:
    apart = np.concatenate([_apart(run) for run in runs])
    heats = np.concatenate([run.columns["heater_duty"] > 0.0 for run in runs])
    known = np.isfinite(apart)
    said = (
        f"the air is the mean of two sensors: the second shows {np.nanmedian(apart):.2g} K more than the "
        f"first in the median, and is {np.nanmax(np.abs(apart)):.2g} K from it at most"
    )
    if not (known & heats).any() or not (known & ~heats).any():
        return said
    on_k, off_k = (float(np.median(apart[known & mask])) for mask in (heats, ~heats))
    if abs(on_k - off_k) < MUCH_K:
        return said
    return (
        f"{said}; {on_k:.2g} K while the heater is on and {off_k:.2g} K while it is off: the air is not "
        "mixed, or one of them is warmed by the heater itself"
    )


USABLE_ROWS = 30  # with a temperature, of all training runs together
FEWEST_STEPS = 5  # of the twin, that all runs last: minutes may have been taken for seconds
PIECE_ROWS = 5  # with a temperature: in fewer, the start takes all that a piece tells
FROM_S = "validate_from_s"
LONGEST_ROWS, ROWS_MAX = 1500, 24_000  # of a run, and of all together: more cost time and tell little
_COLUMN = {name: key for key, name in CONDITIONS.items()}

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class NamedRun:
    """A run at the twin's step, under the name that it has in a report.

    rows_s : times of the rows that the recording has in it [s]; the run's own where it was not resampled
    from_s : when the part begins that a test run judges by [s]; what was before may be known
    rest_of : the training run that a test run goes on from, where one recording is both
    """

    name: str  # `run_01.csv`, `run_01.csv (2 of 3)`, `history_1`
    run: RecordedRun
    rows_s: Floats
    from_s: float | None = None
    rest_of: str = ""

    @property
    def judged_part(self) -> RecordedRun:
        """The part that a test run judges by."""
        if self.from_s is None:
            return self.run
        begin = int((self.run.columns["time_s"] < self.from_s).sum())
        return cut(self.run, min(begin, len(self.run) - 1), len(self.run))

    @property
    def recorded(self) -> NDArray[np.bool_]:
        """True where the recording has a row within half a step of the run's, [len(run)].

        Between the rows of a recording that is coarser than the twin's step readings are interpolated, and
        the air does not go from one to the next by a straight line.
        """
        time_s = self.run.columns["time_s"]
        edges = np.append(time_s[0] - 0.5 * (time_s[1] - time_s[0]), 0.5 * (time_s[1:] + time_s[:-1]))
        counts = np.diff(np.append(np.searchsorted(self.rows_s, edges), len(self.rows_s)))
        return np.asarray(counts > 0)

    def at_rows(self, values: Floats) -> Floats:
        """Values [len(run)] of the run's rows at the recording's own rows, [len(rows_s)]."""
        return np.interp(self.rows_s, self.run.columns["time_s"], values)


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisRuns:
    """Runs to fit on and runs to judge by, which share no row.

    train : at least one; test : may be empty
    told : what was done to the recordings, sentences
    cannot_tell : what they don't tell whatever is computed from them, sentences
    data_sha256 : of the training recordings' numbers as they were read
    step_s : at which they are, whatever that of the twin is
    """

    train: tuple[NamedRun, ...]
    test: tuple[NamedRun, ...]
    notes: tuple[str, ...]
    cannot_tell: tuple[str, ...]
    data_sha256: str
    step_s: float


def read_runs(
    train: Sequence[Path], test: Sequence[Path], twin: TwinFile, without: Collection[str] = ()
) -> DiagnosisRuns:
    """Run files as a diagnosis needs them; `without` as in `read_run`.

    A training run ends where its fact `validate_from_s` says, and is cut where rows are missing for long, and
    one of more than two days into days. A test run stays whole: it may have temperatures in its first rows
    only. One with that fact judges from there on and may know what was before: so one recording may train
    and then test.

    Errors : DataError naming file, line and column: a run of role test to fit on, one file twice, wrong
        units, time that goes backwards, nothing measured, too few rows, a missing column that the twin needs
    """
    if not train:
        raise DataError("diagnosis: needs at least one training run")
    paths = [*train, *test]
    read = [
        plausible_run(read_table(Path(path)), without, twin.sensor.get("highest_c"), twin.sample_s)
        for path in paths
    ]
    recordings = [run for run, _ in read]
    for run in recordings[: len(train)]:
        refuse_test(run)
    _refuse_twice(recordings[: len(train)], recordings[len(train) :])
    # Names by the files: two runs of one name would be one in the report.
    names = _names(paths)
    return diagnosis_runs(
        list(zip(names[: len(train)], recordings[: len(train)], strict=True)),
        list(zip(names[len(train) :], recordings[len(train) :], strict=True)),
        twin,
        tuple(note for _, notes in read for note in notes),
    )


def diagnosis_runs(
    train: Sequence[tuple[str, RecordedRun]],
    test: Sequence[tuple[str, RecordedRun]],
    twin: TwinFile,
    told: Sequence[str] = (),
) -> DiagnosisRuns:
    """Return named recordings in the form that a diagnosis needs. Errors: DataError, as `read_runs`"""
    sha256 = data_sha256([run for _, run in train])
    # Known by content, not by name: one recording may train and then test, from its fact on.
    ends = {data_sha256([run]): name for name, run in train}
    rests = {name: ends.get(data_sha256([run]), "") for name, run in test}
    train, test, two_sensors = average(train, test)
    fitted = [(name, _until_validation(run)) for name, run in train]
    _check_columns([run for _, run in fitted], [run for _, run in test], twin)
    notes, step_s = [*told, *two_sensors], usual_step_s([run for _, run in fitted])
    training = [piece for name, run in fitted for piece in _training_pieces(name, run, step_s, notes)]
    _check_rows([run for _, run in fitted], training, twin.sample_s)
    runs = [piece.run for piece in training]
    judging = tuple(_whole(name, run, step_s, rests[name], notes) for name, run in test)
    return DiagnosisRuns(
        tuple(training),
        judging,
        tuple(notes),
        cannot_tell(runs, {item.name: item.judged_part for item in judging}, len(train)),
        sha256,
        step_s,
    )


def usual_step_s(runs: Sequence[RecordedRun]) -> float:
    """Return the recordings' own step, or a multiple that leaves few enough rows."""
    times = [run.columns["time_s"] for run in runs]
    steps = np.concatenate([np.diff(time_s) for time_s in times])
    own_s = float(np.median(steps)) if len(steps) else USUAL_STEP_S
    lengths = [min(float(time_s[-1] - time_s[0]), LONGEST_S) for time_s in times]
    total_s = sum(float(time_s[-1] - time_s[0]) for time_s in times)
    rows = max(max(lengths) / own_s / LONGEST_ROWS, total_s / own_s / ROWS_MAX)
    return own_s * max(1, math.ceil(rows))


def _names(paths: Sequence[Path]) -> list[str]:
    """File names, with the folder where two files have one name."""
    names = [Path(path).name for path in paths]
    of_name = {name: {path for path in paths if Path(path).name == name} for name in names}
    return [name if len(of_name[name]) == 1 else str(path) for name, path in zip(names, paths, strict=True)]


def _refuse_twice(train: Sequence[RecordedRun], test: Sequence[RecordedRun]) -> None:
    """One recording counted twice is evidence that is not there; in training and test it judges itself,
    unless each has its own part of it."""
    seen: dict[str, RecordedRun] = {}
    for run in (*train, *test):
        before = seen.setdefault(data_sha256([run]), run)
        if before is run:
            continue
        shared = any(before is other for other in train) and not any(run is other for other in train)
        if not shared or FROM_S not in run.facts or before.facts.get(FROM_S) != run.facts[FROM_S]:
            raise DataError(f"{run.path}: is the same recording as {before.path}")


def _until_validation(run: RecordedRun) -> RecordedRun:
    """Return the part of a run that may be fitted."""
    if (from_s := _validate_from_s(run)) is None:
        return run
    rows = int((run.columns["time_s"] < from_s).sum())
    if rows == 0:
        raise DataError(f"{run.path}: {FROM_S}: {run.facts[FROM_S]} leaves no row to fit on")
    part = cut(run, 0, rows)
    return replace(part, facts={key: fact for key, fact in part.facts.items() if key != FROM_S})


def _validate_from_s(run: RecordedRun) -> float | None:
    text = run.facts.get(FROM_S)
    try:
        return None if text is None else float(text)
    except ValueError:
        raise DataError(f"{run.path}: {FROM_S}: {text!r} is no number") from None


def _check_columns(train: Sequence[RecordedRun], test: Sequence[RecordedRun], twin: TwinFile) -> None:
    for run in (*train, *test):
        if not np.isfinite(run.columns["temp_air_c"]).any():
            raise DataError(f"{run.path}: temp_air_c: nothing was measured, every cell is empty")
        for column, effect in twin.twin().needs.items():
            if not has_column(run, column):
                key = "start_utc" if column == "utc" else _COLUMN.get(column, column)
                raise DataError(f"{run.path}: {key}: missing, the twin's {effect} needs it")


def has_column(run: RecordedRun, column: str) -> bool:
    """Return whether a run has a reading of a column, by its internal name or that of a file."""
    if column == "utc":
        return run.start_utc is not None
    values = run.columns.get(_COLUMN.get(column, column))
    return values is not None and bool(np.isfinite(values).any())


def _training_pieces(name: str, run: RecordedRun, step_s: float, told: list[str]) -> list[NamedRun]:
    parts = pieces(run, step_s)
    names = [name if len(parts) == 1 else f"{name} ({i} of {len(parts)})" for i in range(1, len(parts) + 1)]
    found = [_at_step(of, part, step_s) for of, part in zip(names, parts, strict=True)]
    kept = [piece for piece in found if measured_rows(piece.run) >= PIECE_ROWS]
    if len(parts) == 1 and not kept:
        count = measured_rows(found[0].run)
        told.append(f"{name} is left out: it has {count} temperatures, {PIECE_ROWS} are of use")
    if len(parts) > 1:
        short = len(parts) - len(kept)
        left_out = f", {short} of them too short to be of use" if short else ""
        told.append(
            f"{name} is cut into {len(parts)} pieces, where rows are missing or as it lasts for more than "
            f"two days: what bodies had stored is not known where one begins{left_out}"
        )
    _tell_resampled(name, found[0], told)
    return kept


def _whole(name: str, run: RecordedRun, step_s: float, rest_of: str, told: list[str]) -> NamedRun:
    from_s = _validate_from_s(run)
    if from_s is not None and not (run.columns["time_s"] >= from_s).any():
        raise DataError(f"{run.path}: {FROM_S}: {from_s:g} leaves no row to test on")
    piece = _at_step(f"{name} from {from_s:g} s" if rest_of else name, run, step_s)
    _tell_resampled(name, piece, told)
    if len(piece.run) < 2:
        raise DataError(f"{run.path}: reaches over less than one step of {step_s:g} s: nothing to forecast")
    return replace(piece, from_s=from_s, rest_of=rest_of)


def _at_step(name: str, run: RecordedRun, step_s: float) -> NamedRun:
    return NamedRun(name, resample(run, step_s), run.columns["time_s"])


def _tell_resampled(name: str, piece: NamedRun, told: list[str]) -> None:
    if len(piece.rows_s) != len(piece.run):
        usual_s = float(np.median(np.diff(piece.rows_s))) if len(piece.rows_s) > 1 else 0.0
        piece_s = float(np.median(np.diff(piece.run.columns["time_s"])))
        told.append(f"{name} has rows {usual_s:g} s apart and is resampled to {piece_s:g} s")


def judged_from(run: RecordedRun, row: int) -> RecordedRun:
    """Return a run that says from which row on it judges, and no fit may see it."""
    return replace(run, facts={**run.facts, FROM_S: f"{run.columns['time_s'][row]:.3f}"})


def measured_rows(run: RecordedRun) -> int:
    """Return how many rows have a temperature."""
    return int(np.isfinite(run.columns["temp_air_c"]).sum())


def _check_rows(recordings: Sequence[RecordedRun], training: Sequence[NamedRun], step_s: float) -> None:
    usable = sum(measured_rows(piece.run) for piece in training)
    place = f"{recordings[0].path}: " if len(recordings) == 1 else ""
    if usable < USABLE_ROWS:
        raise DataError(
            f"{place}{usable} usable rows: these data can't tell anything, at least {USABLE_ROWS} are needed"
        )
    lasts_s = sum(float(run.columns["time_s"][-1] - run.columns["time_s"][0]) for run in recordings)
    if lasts_s < FEWEST_STEPS * step_s:
        raise DataError(
            f"{place}time_s: the runs last {lasts_s:g} s, less than {FEWEST_STEPS} steps of the twin's "
            f"{step_s:g} s; is time_s in seconds?"
        )
