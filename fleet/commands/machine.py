"""`greenhouse fleet up` and `down`: a fleet on this machine, as services, or below this process for a try."""

import argparse
import sys
from pathlib import Path

from fleet.machine import service
from fleet.machine.engines import engines
from fleet.machine.foreground import end_foreground, run_below
from fleet.machine.places import FOLDER, USER, places_of
from fleet.machine.setting_up import set_up


def add_up_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder and the names."""
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of its settings; usual: %(default)s")
    parser.add_argument(
        "--foreground",
        action="store_true",
        help="a try without root: until Ctrl-C, this machine alone",
    )
    parser.add_argument(
        "--name", action="append", default=[], help="by which rigs and browsers reach it; may be given again"
    )


def run_up(arguments: argparse.Namespace) -> int:
    """Start it. Errors: RequestError, ConfigError, DataError, OSError"""
    places = places_of(arguments.folder)
    if not arguments.foreground:
        service.check_root()
        service.check_program(Path(sys.executable))
    machine = set_up(places, arguments.name, arguments.foreground, _tell)
    programs = list(engines(places, machine))
    if arguments.foreground:
        _tell(f"{machine.address}/ will be the page; logs are in {machine.data}/log")
        return run_below(places, machine, programs, _tell)
    service.make_user(machine)
    service.give_files(places, machine)
    service.start(programs, machine, places)
    _tell(f"{machine.address}/ is the page; make a person: greenhouse fleet user add NAME --role admin")
    return 0


def _tell(words: str) -> None:
    print(words, flush=True)


def add_down_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder and the end of its data."""
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of its settings; usual: %(default)s")
    parser.add_argument(
        "--erase",
        action="store_true",
        help="delete settings, certificates, numbers, tables and papers of rigs for good",
    )


def run_down(arguments: argparse.Namespace) -> int:
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
