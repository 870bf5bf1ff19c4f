"""`greenhouse fleet user`: people who may log in, and their role in each group."""

import argparse
import re

from edge.commands.page import ask_password
from edge.config.settings import NAME
from edge.core.errors import RequestError
from edge.page.access import ROLES, Role
from fleet.database.base import open_database
from fleet.page.people import EVERY, People
from fleet.settings import FleetSettings


def add_arguments(parser: argparse.ArgumentParser) -> None:
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


def run(settings: FleetSettings, arguments: argparse.Namespace) -> int:
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
