"""`greenhouse fleet down`: the end of a fleet on this machine. Data stays unless it is to be erased."""

import argparse
from pathlib import Path

from fleet.machine import service
from fleet.machine.foreground import end_foreground
from fleet.machine.places import FOLDER, USER, places_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder and the end of its data."""
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of its settings; usual: %(default)s")
    parser.add_argument(
        "--erase",
        action="store_true",
        help="delete settings, certificates, numbers, tables and papers of rigs for good",
    )


def run(arguments: argparse.Namespace) -> int:
    """End it. Errors: RequestError, OSError"""
    places = places_of(arguments.folder)
    machine = places.read()
    ended = end_foreground(places)
    if machine.user == USER:
        service.check_root()
        ended = service.end(machine) or ended
    print("the fleet has ended" if ended else "nothing was running")
    if arguments.erase:
        service.erase(places, machine)
        print(f"{machine.data} and {places.folder} are deleted: every rig needs new papers from now on")
    else:
        print(f"its data stays in {machine.data}, its settings and certificates in {places.folder}")
        print("`greenhouse fleet up` goes on with them; `greenhouse fleet down --erase` deletes them")
    return 0
