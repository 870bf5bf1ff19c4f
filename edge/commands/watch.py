"""`greenhouse watch`: what the running daemon does, one line per tick, from its control socket."""

import argparse
import time
from pathlib import Path
from typing import Any

from edge.control_socket import request
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
            print(line(tick), flush=True)
        time.sleep(POLL_S)


def line(tick: dict[str, Any]) -> str:
    """One tick of the control socket's `status` on one line."""
    air = tick["readings"].get("temp_air_c", {"value": None, "quality": "absent"})
    shown = f"{air['value']:.1f}" if air["value"] is not None else air["quality"]
    sent = tick["sent"]
    rules = ",".join(dict.fromkeys(change["rule"] for change in tick["changes"])) or "-"
    return (
        f"tick {tick['seq']} air {shown} degC ref {tick['reference_c']} heater {sent['heater_duty']:.2f} "
        f"fan {'on' if sent['fan_on'] else 'off'} {tick['controller']} safety {rules}"
    )
