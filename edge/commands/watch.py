"""`greenhouse watch`: print what the running daemon does, tick by tick, from its control socket."""

import argparse
import shutil
import sys
import time

from edge.app.display import tick_line
from edge.commands.which_rig import add_socket, socket_of
from edge.sockets.client import request

POLL_S = 0.25  # a demo makes two ticks a second


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
            columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
            print(tick_line(tick, columns), flush=True)
        time.sleep(POLL_S)
