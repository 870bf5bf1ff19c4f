"""`greenhouse twin diagnose`: where twin and measurements disagree, what is missing, and the gap without it.

The report folder gets report.html, diagnosis.json and twin_before.yaml; where a better twin was found,
twin.yaml; where rivals are left, next_experiment.csv, a profile for `greenhouse experiment`.
"""

import argparse
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from edge.commands.arguments import whole, writing
from edge.config import loading as config
from edge.diagnosis.progress import TerminalProgress
from edge.diagnosis.report.summary import summary_text
from edge.formats.atomic_file import make_folder
from edge.twin.twin_file import read_twin_file, write_twin_file

if TYPE_CHECKING:
    from edge.diagnosis.experiment.sequence import ExperimentLimits
from edge.commands.arguments import add_absent_columns, add_times, bounds, number
from edge.commands.which_rig import RIG_CONFIG, history_of
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
        type=whole(1),
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
    from edge.storage.runs import export_stretches

    path = history_of(arguments.history)
    stretches = export_stretches(path, *bounds(arguments, path))
    share = TEST_SHARE if arguments.test_share is None else arguments.test_share
    if arguments.rows is not None and arguments.rows < 1:
        raise RequestError(f"--rows: {arguments.rows} is not above 0")
    return history_runs(stretches, twin, share, str(path), arguments.rows)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the action."""
    add_data_arguments(parser)
    parser.add_argument("--twin", type=Path, required=True, help="twin file with what is known already")
    parser.add_argument("--out", type=Path, required=True, help="folder for the report")
    parser.add_argument(
        "--config",
        type=Path,
        help="configuration file with the next experiment's limits; default: the rig's where there is one",
    )
    parser.add_argument(
        "--json-only", action="store_true", help="no pictures: diagnosis.json and the twin alone"
    )


def run(arguments: argparse.Namespace) -> int:
    """0 whatever the verdict. Errors: DataError, RequestError"""
    # Late: the imports of the fits would slow the start of every other command.
    from edge.diagnosis.answer import answer, traces
    from edge.diagnosis.diagnose import diagnose
    from edge.diagnosis.diagnosis_file import write_json
    from edge.diagnosis.experiment.document import write_profile
    from edge.diagnosis.experiment.plan import next_experiment
    from edge.diagnosis.report.page import PAGE_NAME, write_report
    from edge.diagnosis.report.story import Story
    from edge.diagnosis.where import locate

    file = read_twin_file(arguments.twin)
    data = diagnosis_runs_of(arguments, file)
    limits = _limits(arguments.config, file.geometry["heater_max_w"].value)
    command = shlex.join(["greenhouse", *sys.argv[1:]])
    with writing(arguments.out):
        make_folder(arguments.out)
    with TerminalProgress() as progress:
        found = diagnose(file, data, progress, command)
        progress("where it disagrees", 0.96)
        places = locate(found)
        progress("the next experiment", 0.97)
        experiment = next_experiment(found, limits)
        document = answer(found, places, command, experiment)
        with writing(arguments.out):
            write_twin_file(file, arguments.out / "twin_before.yaml")
            if found.is_offered:
                write_twin_file(found.adopted, arguments.out / "twin.yaml")
            write_profile(experiment, arguments.out)
            if arguments.json_only:
                write_json(arguments.out / "diagnosis.json", document)
            else:
                progress("the report", 0.98)
                story = Story(document, traces(found, places))
                del found, places  # all fits: matplotlib comes where they were, or two weeks take over 300 MB
                write_report(arguments.out, story)
    page = None if arguments.json_only else PAGE_NAME
    print(summary_text(document, str(arguments.out), page), end="")
    return 0


def _limits(path: Path | None, heater_w: float) -> "ExperimentLimits":
    """Those of the rig. heater_w : of the twin. Errors: ConfigError"""
    from edge.diagnosis.experiment.sequence import ExperimentLimits

    if path is None and not os.access(RIG_CONFIG, os.R_OK):
        return ExperimentLimits(heater_w=heater_w)
    settings = config.load(path or RIG_CONFIG)
    return ExperimentLimits(settings.safety, settings.control.step_s, heater_w=heater_w)
