"""`greenhouse ask "keep 26 by day and 20 at night"`: words become a proposal; a person applies it, or not."""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from edge.assistant.requests.prediction import effect_table
from edge.commands.which_rig import add_socket, socket_of
from edge.core.errors import RequestError
from edge.sockets.client import request

PATIENCE_S = 300.0  # a language model on a small machine is slow
_POLL_S = 0.3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("words", nargs="+", help="what you want, in your own words")
    parser.add_argument("--yes", action="store_true", help="apply the proposal without asking back")
    add_socket(parser)


def run(arguments: argparse.Namespace) -> int:
    """0 when the proposal was applied or left to be confirmed, 1 when there is none."""
    socket = socket_of(arguments)
    answer = _ask(socket, {"do": "ask", "words": " ".join(arguments.words)})
    proposal = _thought_out(socket, answer["proposal"])
    if proposal["state"] != "ready":
        print(f"{proposal['said']}" if proposal["state"] == "question" else f"failed: {proposal['error']}")
        return 1
    print("\n".join(_page(proposal)))
    if not (arguments.yes or _has_agreed()):
        print(f"\nnothing is applied; within 15 min: greenhouse confirm {proposal['id']}")
        return 0
    _ask(socket, {"do": "confirm", "id": proposal["id"]})
    print("applied; `greenhouse undo` takes it back")
    return 0


def _page(proposal: dict[str, Any]) -> list[str]:
    return [
        f"proposal {proposal['id']}",
        *(f"  {line}" for line in proposal["changes"]),
        f"the language model says: {proposal['said']}",
        "",
        *effect_table(proposal["effect"]),
    ]


def _thought_out(socket: Path, proposal: dict[str, Any]) -> dict[str, Any]:
    give_up = time.monotonic() + PATIENCE_S
    while proposal["state"] == "thinking":
        if time.monotonic() > give_up:
            raise RequestError(f"no proposal within {PATIENCE_S:g} s")
        time.sleep(_POLL_S)
        proposal = _ask(socket, {"do": "proposal", "id": proposal["id"]})["proposal"]
    return proposal


def _ask(socket: Path, message: dict[str, Any]) -> dict[str, Any]:
    answer = request(socket, message)
    if not answer.get("ok", False):
        raise RequestError(str(answer.get("error", answer)))
    return answer


def _has_agreed() -> bool:
    """Only a person at a terminal can say yes."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        return False
    return input("\napply this? [y/N] ").strip().lower() in ("y", "yes")
