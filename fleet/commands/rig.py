"""`greenhouse fleet rig`: the rigs that may come in."""

import argparse
from pathlib import Path

from fleet.machine.places import FOLDER, places_of
from fleet.machine.rig_papers import read_papers
from fleet.machine.rig_register import add_rig, remove_rig

NO_BROKER = "no broker runs: the rig can come in after `greenhouse fleet up`"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    add = actions.add_parser("add", help="make certificate, rights and the archive that a rig takes with it")
    add.add_argument("name", metavar="NAME", help="second level of the rig's topics")
    add_membership(add)
    listing = actions.add_parser("list", help="list rigs that may come in")
    remove = actions.add_parser("remove", help="take a rig's rights away; what it has sent stays")
    remove.add_argument("name", metavar="NAME")
    remove.add_argument("--erase", action="store_true", help="delete its numbers and rows too")
    for each in (add, listing, remove):
        each.add_argument("--folder", type=Path, default=FOLDER, help="of the fleet; usual: %(default)s")


def add_membership(add: argparse.ArgumentParser) -> None:
    """Add what rigs that come in have in common, and where their archive goes."""
    add.add_argument("--group", default="", help="whose people may see them; usual: only who may see all")
    add.add_argument("--kind", default="", help="boxes that are built alike share one")
    add.add_argument("--out", type=Path, help="archive to write; usual: NAME.tar.gz")


def run(arguments: argparse.Namespace) -> int:
    """Carry out an action. Errors: RequestError, ConfigError, DataError, OSError"""
    places = places_of(arguments.folder)
    match arguments.action:
        case "add":
            out = arguments.out or Path(f"{arguments.name}.tar.gz")
            known = add_rig(places, arguments.name, arguments.group, arguments.kind, out)
            print(f"{out}: bring it to the rig and follow its README.txt; it holds the rig's secret key")
            if not known:
                print(NO_BROKER)
        case "list":
            for paper in read_papers(places):
                own = (paper.name, paper.group or "-", paper.kind or "-", paper.site)
                print("{:<24} {:<16} {:<16} {}".format(*own).rstrip())
        case "remove":
            left = remove_rig(places, arguments.name, arguments.erase)
            print(left or f"{arguments.name} has no rights any more")
            if not arguments.erase:
                print("its row and numbers stay, and the page lists it as offline")
    return 0
