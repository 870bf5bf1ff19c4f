"""Which recordings a diagnosis is made on: arguments, and what they give."""

import argparse
from pathlib import Path

from edge.commands.absent_columns import add_absent_columns
from edge.commands.numbers import number
from edge.commands.stretch import add_times, bounds
from edge.commands.which_rig import history_of
from edge.config.settings import HistorySettings
from edge.core.errors import RequestError
from edge.diagnosis.history_runs import TEST_SHARE, history_runs
from edge.diagnosis.runs import DiagnosisRuns, read_runs
from edge.twin.twin_file import TwinFile


def add_data_arguments(parser: argparse.ArgumentParser) -> None:
    """Run files, or a stretch of the history."""
    parser.add_argument("train", nargs="*", type=Path, metavar="TRAIN.csv", help="runs to fit on")
    parser.add_argument(
        "--test",
        nargs="+",
        type=Path,
        default=[],
        metavar="TEST.csv",
        help="runs that show the gap and have no part in the choice; only their first rows need temperatures",
    )
    parser.add_argument(
        "--history",
        type=Path,
        help=f"database to read instead of run files; default: {HistorySettings().path}",
    )
    add_absent_columns(parser, "fan_on", "temp_ambient_c")
    add_times(parser)
    # None says "not given": a share goes with a history alone.
    parser.add_argument(
        "--test-share",
        type=number(0.0, 1.0),
        help=f"share 0..1 of the rows, the newest, that becomes test runs; default: {TEST_SHARE:g}",
    )
    parser.add_argument(
        "--rows",
        type=int,
        help="use so many of the newest rows of the history; memory grows with them; default: all",
    )


def diagnosis_runs_of(arguments: argparse.Namespace, twin: TwinFile) -> DiagnosisRuns:
    """Return the runs that the arguments name. Errors: DataError;
    RequestError for files and history together
    """
    given = (arguments.history, arguments.since, arguments.until, arguments.test_share, arguments.rows)
    if all(value is None for value in given):
        if not arguments.train:
            raise RequestError(
                "nothing to diagnose: give run files, or a time of the history like --since 14d"
            )
        return read_runs(arguments.train, arguments.test, twin, arguments.without)
    if arguments.train or arguments.test:
        raise RequestError("run files and the history don't go together: export what you need of the history")
    from edge.storage.stretches import export_stretches

    path = history_of(arguments.history)
    stretches = export_stretches(path, *bounds(arguments, path))
    share = TEST_SHARE if arguments.test_share is None else arguments.test_share
    if arguments.rows is not None and arguments.rows < 1:
        raise RequestError(f"--rows: {arguments.rows} is not above 0")
    return history_runs(stretches, twin, share, str(path), arguments.rows)
