"""`greenhouse why [--at TIME]`: why a command was sent, from the recorded decisions."""

import argparse
from pathlib import Path

from edge.assistant.why.ask_history import why
from edge.commands.arguments import moment, moment_in
from edge.commands.which_rig import add_socket, socket_of
from edge.core.errors import RequestError
from edge.sockets.client import request


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--at",
        help="the command that held then: 2026-07-01T12:00 (UTC unless it names a zone), or 90min before the "
        "newest; default: the newest",
    )
    parser.add_argument("--history", type=Path, help="read this database instead of asking the daemon")
    add_socket(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the explanation. Errors: RequestError or DataError where there is none"""
    if arguments.history is not None:
        answer = why(arguments.history, moment_in(arguments.history, arguments.at), zone=None)
    else:
        socket = socket_of(arguments)
        answer = request(socket, {"do": "why", "at_utc": _moment_of(socket, arguments.at)})
        if not answer.get("ok", False):
            raise RequestError(str(answer.get("error", answer)))
    print("\n".join(answer["lines"]))
    return 0


def _moment_of(socket: Path, at: str | None) -> float | None:
    """Return the moment by the daemon's clock: a demo's is simulated. Errors: RequestError"""
    if at is None:
        return None
    tick = request(socket, {"do": "status"}).get("tick")
    return moment(at, None if tick is None else tick["utc"])
