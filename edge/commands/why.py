"""`greenhouse why [--at TIME]`: why a command was sent, from the recorded decisions."""

import argparse
from pathlib import Path

from edge.commands.stretch import moment
from edge.commands.which_rig import add_socket, socket_of
from edge.control_socket import request
from edge.errors import RequestError
from edge.why.ask_history import why


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--at",
        help="the command that held then: 2026-07-01T12:00, UTC unless it says a zone; or ago: 90min; "
        "usual: the newest",
    )
    parser.add_argument("--history", type=Path, help="read this database instead of asking the daemon")
    add_socket(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the explanation. Errors: RequestError or DataError where there is none"""
    at_utc = moment(arguments.at)
    if arguments.history is not None:
        answer = why(arguments.history, at_utc, zone=None)
    else:
        answer = request(socket_of(arguments), {"do": "why", "at_utc": at_utc})
        if not answer.get("ok", False):
            raise RequestError(str(answer.get("error", answer)))
    print("\n".join(answer["lines"]))
    return 0
