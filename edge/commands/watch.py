"""`greenhouse watch`: what the running daemon does, one line per tick, from its control socket."""

import argparse
import time
from pathlib import Path

from edge.control_socket import request
from edge.display import tick_line
from edge.settings import ControlSocketSettings

POLL_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--socket", type=Path, default=Path(ControlSocketSettings().path))


def run(arguments: argparse.Namespace) -> int:
    """Until Ctrl-C."""
    seen = None
    while True:
        tick = request(arguments.socket, {"do": "status"}).get("tick")
        if tick is not None and tick["seq"] != seen:
            seen = tick["seq"]
            print(tick_line(tick), flush=True)
        time.sleep(POLL_S)
