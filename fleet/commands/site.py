"""`greenhouse fleet site`: sites whose own broker speaks for their rigs."""

import argparse
from pathlib import Path

from fleet.commands.rig import NO_BROKER, add_membership
from fleet.machine.places import FOLDER, places_of
from fleet.machine.site_register import add_to_site, read_sites, remove_site


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    add = actions.add_parser("add", help="let rigs come in by a broker of their own, or add rigs to a site")
    add.add_argument("name", metavar="NAME", help="of the site")
    add.add_argument("--rigs", nargs="+", required=True, metavar="RIG", help="second level of their topics")
    add_membership(add)
    listing = actions.add_parser("list", help="list sites and their rigs")
    remove = actions.add_parser("remove", help="take the rights of a site and of all its rigs away")
    remove.add_argument("name", metavar="NAME")
    for each in (add, listing, remove):
        each.add_argument("--folder", type=Path, default=FOLDER, help="of the fleet; usual: %(default)s")


def run(arguments: argparse.Namespace) -> int:
    """Carry out an action. Errors: RequestError, ConfigError, DataError, OSError"""
    places = places_of(arguments.folder)
    match arguments.action:
        case "add":
            out = arguments.out or Path(f"{arguments.name}.tar.gz")
            given = (arguments.name, arguments.rigs, arguments.group, arguments.kind)
            is_new, known = add_to_site(places, *given, out)
            holds = "holds the site's secret key" if is_new else "holds no key: the site keeps the one it has"
            print(f"{out}: bring it to the site's broker and follow its README.txt; it {holds}")
            if not known:
                print(NO_BROKER)
        case "list":
            for name, papers in read_sites(places).items():
                print(f"{name:<24} {' '.join(paper.name for paper in papers)}")
        case "remove":
            rigs, left = remove_site(places, arguments.name)
            print(left or f"{arguments.name} has no rights any more, nor have {', '.join(rigs)}")
            print("rows and numbers of its rigs stay; `greenhouse fleet rig remove RIG --erase` deletes them")
    return 0
