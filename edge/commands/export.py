"""`greenhouse export --out RUN`: a stretch of the history, or a named run of it, as a run file."""

import argparse
from pathlib import Path

from edge.commands.arguments import add_bounds, bounds, whole, writing
from edge.commands.which_rig import history_of
from edge.formats.run_file import absence_facts, write_run
from edge.storage.runs import export_run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_bounds(parser)
    parser.add_argument(
        "--run", dest="name", help="a run that was imported or recorded under this name, instead of times"
    )
    parser.add_argument("--first-seq", type=whole(1), help="number of the first tick")
    parser.add_argument("--last-seq", type=whole(1), help="number of the last tick")
    parser.add_argument("--out", type=Path, required=True, help="run file to write")


def run(arguments: argparse.Namespace) -> int:
    """0 when the run file is written."""
    history = history_of(arguments.history)
    recorded = export_run(
        history, arguments.name, arguments.first_seq, arguments.last_seq, *bounds(arguments, history)
    )
    with writing(arguments.out):
        write_run(absence_facts(recorded), arguments.out)
    print(f"{arguments.out}: {len(recorded)} rows")
    return 0
