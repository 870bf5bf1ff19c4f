"""Commands that ask the running daemon over its control socket: `greenhouse status`, `mode`, ..."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from edge.control_socket import request
from edge.inbox import is_in_force
from edge.operation import FanMode, Mode
from edge.settings import ControlSocketSettings

Request = dict[str, Any]
Fill = Callable[[argparse.ArgumentParser], None]


def _target(text: str) -> float | None:
    if text == "none":
        return None
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a temperature nor none") from None


def _mode(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("mode", choices=[mode.value for mode in Mode])


def _fan(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fan_mode", choices=[mode.value for mode in FanMode])


def _reference(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "reference_c", metavar="DEGC|none", type=_target, help="a temperature, or none: as configured"
    )


def _controller(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name")


def _manual(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--heater-duty", type=float, default=0.0, help="0..1")
    parser.add_argument("--fan-on", type=int, choices=(0, 1), default=0)
    parser.add_argument("--led", type=float, default=0.0, help="0..1")


def _maintenance(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("minutes", type=float, help="ends by itself after so long; 0 ends it now")


def _resend(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("first_seq", type=int)
    parser.add_argument("last_seq", type=int)


def _proposal(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("id", help="as `greenhouse ask` has printed it")


def _nothing(parser: argparse.ArgumentParser) -> None:
    pass


ORDERS: dict[str, tuple[str, str, Fill]] = {  # command -> request, help, arguments
    "status": ("status", "standing orders and the last tick, as JSON", _nothing),
    "mode": ("set_mode", "who decides: auto, heat, fan_only, off, manual", _mode),
    "fan": ("set_fan_mode", "fan: auto, on, off", _fan),
    "reference": ("set_reference", "target temperature, over the configured one", _reference),
    "controller": ("set_controller", "change the controller while it runs", _controller),
    "manual": ("set_manual", "a fixed command, until the mode changes", _manual),
    "emergency-stop": ("emergency_stop", "everything off, the fan too, latched on the board", _nothing),
    "release": ("release_emergency_stop", "end an emergency stop", _nothing),
    "clear-trip": ("clear_trip", "forget latched trips whose cause is gone", _nothing),
    "maintenance": (
        "maintenance",
        "hands in the greenhouse: everything off for some minutes, the fan too",
        _maintenance,
    ),
    "confirm": ("confirm", "apply a proposal of `greenhouse ask`", _proposal),
    "undo": ("undo", "end what was confirmed last, as it was before", _nothing),
    "resend": ("resend", "publish recorded ticks again, to fill a gap", _resend),
}


def add_arguments(name: str, parser: argparse.ArgumentParser) -> None:
    """Arguments of one of ORDERS."""
    ORDERS[name][2](parser)
    parser.add_argument("--socket", type=Path, default=Path(ControlSocketSettings().path))


def run(arguments: argparse.Namespace) -> int:
    """Ask, print the answer; 1 when the daemon refuses."""
    name = ORDERS[arguments.command][0]
    values = {key: value for key, value in vars(arguments).items() if key not in ("command", "socket", "run")}
    answer = request(arguments.socket, {"do": name, **values})
    if not answer.get("ok", False):
        print(f"{'warning' if is_in_force(answer) else 'refused'}: {answer.get('error', answer)}")
        return 1
    print(json.dumps(answer, indent=1) if name == "status" else "done")
    if warning := answer.get("warning"):
        print(f"warning: {warning}")
    return 0
