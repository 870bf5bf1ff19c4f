"""`greenhouse plot --out PICTURE [RUN]`: a picture of a run file, or of a stretch of the history."""

import argparse
from pathlib import Path

from edge.app.plot import plot_history, plot_run
from edge.commands.output import writing
from edge.commands.stretch import add_bounds, bounds
from edge.commands.which_rig import history_of
from edge.core.errors import RequestError
from edge.formats.run_file import OPTION_WITHOUT, read_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("run_file", type=Path, nargs="?", metavar="RUN", help="run file; else the history")
    add_bounds(parser)
    parser.add_argument(
        "--out", type=Path, required=True, help="picture: .png, .svg or .pdf; needs matplotlib"
    )


def run(arguments: argparse.Namespace) -> int:
    """0 when the picture is written."""
    if arguments.run_file is not None and (arguments.since is not None or arguments.until is not None):
        raise RequestError("--since and --until are for the history; a run file is drawn whole")
    with writing(arguments.out):
        if arguments.run_file is not None:
            plot_run(read_run(arguments.run_file, OPTION_WITHOUT), arguments.out)
        else:
            history = history_of(arguments.history)
            plot_history(history, *bounds(arguments, history), arguments.out)
    print(arguments.out)
    return 0
