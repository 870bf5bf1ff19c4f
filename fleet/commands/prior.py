"""`greenhouse fleet prior`: the start of a new box's twin, from what the boxes of its kind have in common."""

import argparse
from pathlib import Path

from edge.twin.twin_file import read_twin_file, write_twin_file
from fleet.database.base import open_database
from fleet.jobs.prior_job import newest_prior
from fleet.settings import FleetSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the box, its kind, and the file to write."""
    parser.add_argument("box", type=Path, help="the box's description, as `greenhouse box` writes it")
    parser.add_argument("--kind", required=True, help="of the boxes that are built like it")
    parser.add_argument("--out", type=Path, required=True, help="file for the twin that it starts from")


def run(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Write the start. Errors: DataError"""
    prior = newest_prior(open_database(settings.database))
    write_twin_file(prior.start(read_twin_file(arguments.box), arguments.kind), arguments.out)
    known = prior.shares.keys() - {""}
    if arguments.kind not in known:
        print(f"no box of kind {arguments.kind} has told a twin; its start is what all kinds have in common")
        print(f"known kinds: {', '.join(sorted(known))}")
    print(f"{arguments.out}: name it as box.twin in edge.yaml, then `greenhouse commission` for an hour")
    return 0
