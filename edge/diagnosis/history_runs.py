"""Stretches of the rig's own history as training and test runs: the newest part judges."""

from collections.abc import Sequence

from edge.core.errors import DataError
from edge.diagnosis.runs import (
    PIECE_ROWS,
    DiagnosisRuns,
    diagnosis_runs,
    measured_rows,
    pieces,
)
from edge.formats.run_file import RecordedRun, cut
from edge.twin.twin_file import TwinFile

TEST_SHARE = 0.2


def history_runs(
    stretches: Sequence[RecordedRun],
    twin: TwinFile,
    test_share: float = TEST_SHARE,
    source: str = "the history",
    rows_max: int | None = None,
) -> DiagnosisRuns:
    """Stretches in the order of time, the last `test_share` of their rows as test runs.

    rows_max : newest rows that are used, as memory and time grow with them; a note says from when on

    A stretch of role test is never fitted on, wherever it lies. Runs are called history_1, history_2, ...

    Errors : DataError where nothing is left to fit on, also for a share that leaves nothing
    """
    if not 0.0 <= test_share < 1.0:
        raise DataError(f"--test-share: {test_share:g} is not in 0..1, 1 left out")
    parts = [piece for stretch in stretches for piece in pieces(stretch)]
    chosen = [part for part in parts if measured_rows(part) >= PIECE_ROWS]
    left_out = len(parts) - len(chosen)
    if not chosen:
        raise DataError(f"{source}: no stretch has {PIECE_ROWS} rows with a temperature")
    # The newest rows: an older box may have had another heater.
    every = sum(len(run) for run in chosen)
    chosen = _newest(chosen, every if rows_max is None else rows_max)
    notes = []
    if (rows := sum(len(run) for run in chosen)) < every:
        begun = f"from {chosen[0].facts['start_utc']} on" if "start_utc" in chosen[0].facts else "the newest"
        notes.append(
            f"{rows} of {every} rows of {source} are used, {begun}: more need more memory than is allowed"
        )
    train, test = _divide(chosen, test_share)
    named = [(f"history_{i + 1}", run) for i, run in enumerate([*train, *test])]
    if left_out:
        notes.append(f"{left_out} of {len(parts)} stretches of {source} are too short")
    if not train:
        raise DataError(f"{source}: only runs of role test, which are never fitted on")
    return diagnosis_runs(named[: len(train)], named[len(train) :], twin, notes)


def _newest(runs: Sequence[RecordedRun], rows_max: int) -> list[RecordedRun]:
    """Return the newest rows of all runs together; the run in which the boundary lies is cut there."""
    found: list[RecordedRun] = []
    for run in reversed(runs):
        rows = min(len(run), rows_max)
        rows_max -= rows
        if rows and measured_rows(part := cut(run, len(run) - rows, len(run))) >= PIECE_ROWS:
            found.insert(0, part)
    return found


def _divide(runs: Sequence[RecordedRun], test_share: float) -> tuple[list[RecordedRun], list[RecordedRun]]:
    """Training and test; the run in which the boundary lies is cut there."""
    free = [run for run in runs if not _is_test(run)]
    left = sum(len(run) for run in free)
    left -= round(test_share * left)
    train, test = [], [run for run in runs if _is_test(run)]
    for run in free:
        rows = min(left, len(run))
        left -= rows
        if rows:
            train.append(cut(run, 0, rows))
        if rows < len(run) and measured_rows(part := cut(run, rows, len(run))) >= PIECE_ROWS:
            test.append(part)
    return train, test


def _is_test(run: RecordedRun) -> bool:
    return run.facts.get("role", "").strip().lower() == "test"
