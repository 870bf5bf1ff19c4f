"""`greenhouse memory`: list, add, edit and erase what was decided and noted."""

import argparse
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from edge.commands.arguments import add_actions, whole
from edge.commands.orders import print_answer
from edge.commands.which_rig import add_socket, socket_of
from edge.sockets.client import request

ACTIONS = {
    "list": ("memory", "print all facts, the newest first"),
    "add": ("remember", "write a note"),
    "edit": ("remember", "replace the text of a fact"),
    "forget": ("forget", "erase one fact, or all of them"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command and its actions."""
    parser.set_defaults(socket=None)
    helps = {name: text for name, (_, text) in ACTIONS.items()}
    for name, action in add_actions(parser, helps, otherwise="list").items():
        if name in ("edit", "forget"):
            action.add_argument("id", type=whole(1), nargs=None if name == "edit" else "?", help="as listed")
        if name == "forget":
            action.add_argument("--all", action="store_true", help="erase every fact")
        if name in ("add", "edit"):
            action.add_argument("text", nargs="+", help="in your own words")
        add_socket(action)


def run(arguments: argparse.Namespace) -> int:
    """Ask the daemon; 1 where it refuses. Errors: RequestError"""
    action = arguments.action or "list"
    order: dict[str, Any] = {"do": ACTIONS[action][0]}
    if action in ("add", "edit"):
        order["text"] = " ".join(arguments.text)
    if action in ("edit", "forget"):
        order["id"] = arguments.id
    if action == "forget":
        order["all"] = arguments.all
    answer = request(socket_of(arguments), order)
    if action != "list" or not answer.get("ok", False):
        return print_answer(answer)
    print("\n".join(map(fact_line, answer["facts"])) or "nothing is remembered")
    return 0


def fact_line(fact: Mapping[str, Any]) -> str:
    """Return a fact as the answer to `memory` has it, in one line."""
    edited = "" if fact["edited_utc"] is None else ", edited"
    author = f" by {fact['by']}" if fact["by"] else ""
    return f"{fact['id']:>5d}  {_at(fact['utc'])}  {fact['kind']}{author}{edited}: {fact['text']}"


def _at(utc: float) -> str:
    return f"{datetime.fromtimestamp(utc):%Y-%m-%d %H:%M}"
