"""`greenhouse import RUN...`: run files into the history, beside whatever a daemon writes meanwhile."""

import argparse
from pathlib import Path

from edge.commands.arguments import add_absent_columns
from edge.config.settings import HistorySettings
from edge.formats.run_file import read_run
from edge.storage.runs import import_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="run file; its name names the run")
    parser.add_argument(
        "--history", type=Path, default=Path(HistorySettings().path), help="database; default: %(default)s"
    )
    add_absent_columns(parser, "fan_on", "temp_ambient_c")


def run(arguments: argparse.Namespace) -> int:
    """0 when all are in; those before a wrong one are in too."""
    for path in arguments.runs:
        first, last = import_run(arguments.history, read_run(path, arguments.without), path.stem)
        print(f"{path}: run {path.stem}, ticks {first} to {last}")
    return 0
