"""`greenhouse watch`: what the running daemon does, one line per tick, from its control socket."""

import argparse
import time

from edge.commands.which_rig import add_socket, socket_of
from edge.control_socket import request
from edge.display import tick_line

POLL_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_socket(parser)


def run(arguments: argparse.Namespace) -> int:
    """Until Ctrl-C."""
    socket, seen = socket_of(arguments), None
    while True:
        tick = request(socket, {"do": "status"}).get("tick")
        if tick is not None and tick["seq"] != seen:
            seen = tick["seq"]
            print(tick_line(tick), flush=True)
        time.sleep(POLL_S)
