"""`greenhouse profile`: the daemon follows a file of targets; pause it, skip to its next point, end it."""

import argparse
from pathlib import Path
from typing import Any

from edge.commands.arguments import add_actions
from edge.commands.orders import print_answer
from edge.commands.which_rig import add_socket, socket_of
from edge.core.errors import DataError
from edge.sockets.client import request
from edge.tick.reference import reference_from_profile
from edge.tick.standing_profile import NAME_MAX, POINTS_MAX

ACTIONS = {
    "start": "follow a CSV file with the columns time_s and reference_c instead of the configured reference",
    "pause": "hold the present target until `resume`",
    "resume": "go on where it was",
    "skip": "go on from its next point",
    "end": "follow the configured reference again",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command and its actions."""
    for name, action in add_actions(parser, ACTIONS).items():
        if name == "start":
            action.add_argument("file", type=Path, help="times rise from 0 [s]; a row holds until the next")
            action.add_argument("--lines", action="store_true", help="straight lines from row to row instead")
        add_socket(action)


def run(arguments: argparse.Namespace) -> int:
    """Ask the daemon; 1 where it refuses. Errors: DataError for the file, RequestError"""
    order: dict[str, Any] = {"do": f"{arguments.action}_profile"}
    if arguments.action == "start":
        order["profile"] = order_of(arguments.file, arguments.lines)
    return print_answer(request(socket_of(arguments), order))


def order_of(file: Path, is_linear: bool) -> dict[str, Any]:
    """Return a file's targets as the order has them. Errors: DataError"""
    found = reference_from_profile(file)
    times, targets = found.times_s.tolist(), found.values_c.tolist()
    if len(times) > POINTS_MAX:
        raise DataError(f"{file}: {len(times)} rows; a rig follows {POINTS_MAX} at most")
    return {"name": file.stem[:NAME_MAX], "times_s": times, "targets_c": targets, "linear": is_linear}
