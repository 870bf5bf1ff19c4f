"""`greenhouse page`: serve the web page; pair, link, person, sessions and revoke say who may do what."""

import argparse
import getpass
import os
import sys
import time
from datetime import datetime
from pathlib import Path

from edge.commands.arguments import add_actions, number, whole
from edge.commands.bundle import settings_of
from edge.commands.which_rig import RIG_CONFIG
from edge.config.settings import Settings
from edge.core.errors import ConfigError, RequestError
from edge.formats.owner import become_owner
from edge.page.access import DAY_S, LINK_DAYS_MAX, RIGHTS, ROLES, Access, Role
from edge.page.address import address
from edge.page.alarms import trial
from edge.page.child import is_installed

MISSING = "the page needs more packages: pip install 'greenhouse-twin[page]'"
ACTIONS = {
    "pair": "open the page to the network, and print a link for one browser",
    "link": "print a link to hand on, by default to view for a week",
    "person": "set the password of somebody who logs in by name",
    "sessions": "list the browsers that have a session, the links and the people",
    "revoke": "end a session, a link, a person's password, or all sessions and links",
    "test-alarm": "have the running page send a test message by each channel, and say how it went",
}
TRIAL_LOOK_S = 0.2  # between two looks whether the page has answered
PAIR_H = 1.0  # a link for once is used at once


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command and its actions."""
    parser.add_argument(
        "--config", type=Path, help=f"configuration file; default: {RIG_CONFIG}, else every setting's default"
    )
    pair, link, person, _, revoke, _ = add_actions(parser, ACTIONS, otherwise="serve the page").values()
    for each, role in ((pair, Role.ADMIN), (link, Role.VIEW)):
        each.add_argument(
            "--role", choices=ROLES, default=role.word, help="what they may; default: %(default)s"
        )
        each.add_argument("--name", default="", help="stands beside orders in the history")
    link.add_argument("--days", type=number(1e-3, LINK_DAYS_MAX), default=7.0, help="how long; default: 7")
    person.add_argument("name", help="stands beside orders in the history")
    person.add_argument(
        "--role", choices=ROLES, default=Role.OPERATE.word, help="what they may; default: %(default)s"
    )
    row = whole(1, 2**63 - 1)  # SQLite's largest integer
    ends = revoke.add_mutually_exclusive_group()
    ends.add_argument("session", type=row, nargs="?", help="its number; default: all sessions and links")
    ends.add_argument("--link", type=row, metavar="N", help="this link, and the sessions that began by it")
    ends.add_argument("--person", metavar="NAME", help="this person's password and sessions")


def run(arguments: argparse.Namespace) -> int:
    """Serve until Ctrl-C, or do what the action says."""
    settings = settings_of(arguments.config)
    access = Access.of(settings.page.folder)
    become_owner(access.path)
    match arguments.action:
        case None:
            _serve(arguments.config)
        case "pair":
            access.open_to_network()
            _print_link(settings, access, arguments, PAIR_H / 24.0, 1)
        case "link":
            _print_link(settings, access, arguments, arguments.days, None if arguments.role == "view" else 1)
        case "person":
            access.set_password(arguments.name, ROLES[arguments.role], ask_password())
            print(f"{arguments.name} may log in now ({arguments.role}).")
        case "sessions":
            _print_sessions(access)
        case "revoke":
            print(_revoke(access, arguments))
        case "test-alarm":
            return _test_alarm(settings, access)
    return 0


def _serve(file: Path | None) -> None:
    """Become the page's own process. Errors: ConfigError where packages are missing"""
    if not is_installed():
        raise ConfigError(MISSING)
    usual = RIG_CONFIG if RIG_CONFIG.exists() else ""
    os.execv(sys.executable, [sys.executable, "-m", "edge.page", str(file or usual)])


def _print_link(
    settings: Settings, access: Access, given: argparse.Namespace, days: float, uses: int | None
) -> None:
    secret = access.make_link(ROLES[given.role], given.name or given.role, days * DAY_S, uses)
    how = "for one browser" if uses else "for whoever has it"
    until = f"within {24.0 * days:g} h" if days < 1.0 else f"for {days:g} days"
    print(f"{given.role}, {how}, {until}:", file=sys.stderr)
    # Behind "#", which no browser sends, so the secret stands in no log on the way.
    print(f"{address(settings, access.is_open_to_network)}#link={secret}")


def _test_alarm(settings: Settings, access: Access) -> int:
    """Print how each channel of the running page has done. Errors: RequestError where no page answers"""
    if not settings.alarms.is_on:
        raise RequestError("no channel is configured: see the section alarms of edge.yaml")
    name, end_s = trial.ask(access, time.time()), time.monotonic() + trial.TRIAL_MAX_S
    while (reasons := trial.answer_of(access, name)) is None:
        if time.monotonic() > end_s:
            raise RequestError(
                f"no page has answered within {trial.TRIAL_MAX_S:g} s: does it run, with this configuration? "
                "systemctl restart greenhouse-page"
            )
        time.sleep(TRIAL_LOOK_S)
    for channel, reason in reasons.items():
        print(f"{channel:10}{reason or 'arrived'}")
    return 1 if any(reasons.values()) else 0


def ask_password() -> str:
    """Read a password twice from a terminal, once from a pipe. Errors: RequestError"""
    first = getpass.getpass("password: ")
    if sys.stdin.isatty() and getpass.getpass("again: ") != first:
        raise RequestError("the two differ")
    return first


def _revoke(access: Access, given: argparse.Namespace) -> str:
    """Return what has ended. Errors: RequestError for what is not there"""
    links, keys = access.links(), (given.session, given.link, given.person)
    rights = zip(RIGHTS, ("session", "link", "person"), keys, strict=True)
    kind, word, key = next((each for each in rights if each[2] is not None), ("", "", ""))
    if not kind:
        text = f"{len(access.revoke_all())} sessions, {len(links)} links"
        return f"All ended: {text}. Passwords still work; --person NAME ends one."
    if access.role_of(kind, key) is None:
        ways = "sessions (revoke N), links (--link N) and people (--person NAME)"
        raise RequestError(f"there is no {word} {key}: `greenhouse page sessions` lists {ways}")
    link = next((row["link"] for row in access.sessions() if row["session"] == key), None)
    count = len(access.revoke(kind, key))
    if word == "session":
        left = f"; link {link}, which it came from, still works: --link {link}"
        return f"Session {key} ended{left * (link in [row['link'] for row in access.links()])}."
    ended = f"{count} session{'s' * (count != 1)} ended"
    if word == "link":
        return f"Link {key} no longer works; {ended if count else 'no browser has a session by it'}."
    return f"{key} can no longer log in; {ended}."


def _print_sessions(access: Access) -> None:
    for row in access.sessions():
        seen = datetime.fromtimestamp(float(str(row["seen_utc"])))
        who = f"session {row['session']}  {row['role']:8}{row['name']:20}"
        print(f"{who}seen {seen:%Y-%m-%d %H:%M}  {row['browser']}")
    for row in access.links():
        left = "any number of browsers" if row["uses_left"] is None else f"{row['uses_left']} more browsers"
        until = datetime.fromtimestamp(float(str(row["expires_utc"])))
        print(f"link {row['link']}  {row['role']:8}{row['name']:20}{left} until {until:%Y-%m-%d %H:%M}")
    for row in access.people():
        print(f"person  {row['role']:8}{row['name']}")
