"""`greenhouse fleet rig`, `site` and `user`: who may come in."""

import argparse
import re
from pathlib import Path

from edge.commands.page import ask_password
from edge.config.settings import NAME
from edge.core.errors import RequestError
from edge.page.access import ROLES, Role
from fleet.database.base import open_database
from fleet.machine.places import FOLDER, places_of
from fleet.machine.rig_papers import read_papers
from fleet.machine.rig_register import add_rig, add_to_site, read_sites, remove_rig, remove_site
from fleet.page.people import EVERY, People
from fleet.settings import FleetSettings

NO_BROKER = "no broker runs: the rig can come in after `greenhouse fleet up`"


def add_rig_arguments(parser: argparse.ArgumentParser) -> None:
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


def run_rig(arguments: argparse.Namespace) -> int:
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


def add_site_arguments(parser: argparse.ArgumentParser) -> None:
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


def run_site(arguments: argparse.Namespace) -> int:
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


def add_user_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    add = actions.add_parser("add", help="give somebody a role in a group; asks for a password")
    add.add_argument("name", help="stands beside their orders")
    add.add_argument("--group", default=EVERY, help="usual: %(default)s, all groups")
    add.add_argument("--role", choices=ROLES, default=Role.VIEW.word, help="usual: %(default)s")
    add.add_argument("--keep-password", action="store_true", help="leave the password that they have")
    actions.add_parser("list", help="list people and their roles")
    remove = actions.add_parser("remove", help="take a role away; with the last one the person")
    remove.add_argument("name")
    remove.add_argument("--group", help="of this group alone; usual: all roles, and the person")


def run_user(settings: FleetSettings, arguments: argparse.Namespace) -> int:
    """Carry out an action. Errors: RequestError, DataError"""
    people = People(open_database(settings.database))
    match arguments.action:
        case "add":
            if arguments.group != EVERY and not re.fullmatch(NAME, arguments.group):
                raise RequestError(f"--group: {arguments.group!r} does not match {NAME}")
            password = None if arguments.keep_password else ask_password()
            people.add(arguments.name, arguments.group, ROLES[arguments.role], password)
        case "remove":
            people.remove(arguments.name, arguments.group)
        case "list":
            for name, group, role in people.rights():
                print(f"{name:<24} {group:<24} {role.word}")
    return 0
