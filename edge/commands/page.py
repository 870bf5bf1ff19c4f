"""`greenhouse page`: serve the web page; pair, link, person, sessions and revoke say who may do what."""

import argparse
import getpass
import ipaddress
import os
import socket
import sys
from datetime import datetime
from pathlib import Path

from edge.commands.bundle import settings_of
from edge.commands.which_rig import RIG_CONFIG
from edge.config.settings import Settings
from edge.core.errors import ConfigError, RequestError
from edge.page.access import DAY_S, LINK_DAYS_MAX, ROLES, Access, Role
from edge.page.child import is_installed

MISSING = "the page needs more packages: pip install 'greenhouse-twin[page]'"
ACTIONS = {
    "pair": "open the page to the network, and print a link for one browser",
    "link": "print a link to hand on, by default to view for a week",
    "person": "set the password of somebody who logs in by name",
    "sessions": "list the browsers that have a session",
    "revoke": "end a session, or all sessions and links",
}
PAIR_H = 1.0  # a link for once is used at once


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command and its actions."""
    parser.add_argument(
        "--config", type=Path, help=f"configuration file; default: {RIG_CONFIG}, else every setting's default"
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", help="default: serve the page")
    pair, link, person, _, revoke = (
        actions.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        for name, text in ACTIONS.items()
    )
    for each, role in ((pair, Role.ADMIN), (link, Role.VIEW)):
        each.add_argument(
            "--role", choices=ROLES, default=role.word, help="what they may; default: %(default)s"
        )
        each.add_argument("--name", default="", help="stands beside orders in the history")
    link.add_argument("--days", type=float, default=7.0, help="how long it is valid; default: 7")
    person.add_argument("name", help="stands beside orders in the history")
    person.add_argument(
        "--role", choices=ROLES, default=Role.OPERATE.word, help="what they may; default: %(default)s"
    )
    revoke.add_argument("session", type=int, nargs="?", help="its number; default: all")


def run(arguments: argparse.Namespace) -> int:
    """Serve until Ctrl-C, or do what the action says."""
    settings = settings_of(arguments.config)
    access = Access.of(settings.page.folder)
    match arguments.action:
        case None:
            _serve(arguments.config)
        case "pair":
            access.open_to_network()
            _print_link(settings, access, arguments, PAIR_H / 24.0, 1)
        case "link":
            _print_link(settings, access, arguments, arguments.days, None if arguments.role == "view" else 1)
        case "person":
            access.set_password(arguments.name, ROLES[arguments.role], _password())
        case "sessions":
            _print_sessions(access)
        case "revoke":
            print(f"{access.revoke(arguments.session)} sessions ended")
    return 0


def _serve(file: Path | None) -> None:
    """Become the page's own process. Errors: ConfigError where packages are missing"""
    if not is_installed():
        raise ConfigError(MISSING)
    usual = RIG_CONFIG if RIG_CONFIG.exists() else ""
    os.execv(sys.executable, [sys.executable, "-m", "edge.page", str(file or usual)])


def address(settings: Settings, opened: bool) -> str:
    """Return where a browser finds the page."""
    page = settings.page
    name = next(iter(page.names), "")
    if name and _is_loopback(page.host):
        return f"https://{name}/"  # no name but a proxy's leads to a page that listens to this machine alone
    scheme = "https" if page.certificate else "http"
    name = name or (page.host.strip("0:.") and page.host)
    host = name or (f"{socket.gethostname().partition('.')[0]}.local" if opened else "127.0.0.1")
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{page.port}/"


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _print_link(
    settings: Settings, access: Access, given: argparse.Namespace, days: float, uses: int | None
) -> None:
    if not 0.0 < days <= LINK_DAYS_MAX:
        raise RequestError(f"--days: above 0, at most {LINK_DAYS_MAX:g}")
    secret = access.make_link(ROLES[given.role], given.name or given.role, days * DAY_S, uses)
    how = "for one browser" if uses else "for whoever has it"
    until = f"within {24.0 * days:g} h" if days < 1.0 else f"for {days:g} days"
    print(f"{given.role}, {how}, {until}:", file=sys.stderr)
    # Behind "#", which no browser sends, so the secret stands in no log on the way.
    print(f"{address(settings, access.is_open_to_network)}#link={secret}")


def _password() -> str:
    first = getpass.getpass("password: ")
    if sys.stdin.isatty() and getpass.getpass("again: ") != first:
        raise RequestError("the two differ")
    return first


def _print_sessions(access: Access) -> None:
    for row in access.sessions():
        seen = datetime.fromtimestamp(float(str(row["seen_utc"])))
        print(
            f"{row['session']:4}  {row['role']:8}{row['name']:20}seen {seen:%Y-%m-%d %H:%M}  {row['browser']}"
        )
