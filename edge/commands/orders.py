"""Commands that ask the running daemon over its control socket: `greenhouse status`, `mode`, ..."""

import argparse
import json
import sys
from collections.abc import Callable
from typing import Any

from edge.commands.numbers import number, whole
from edge.commands.status_text import status_lines
from edge.commands.which_rig import add_socket, socket_of
from edge.core.hard_limits import MAINTENANCE_MAX_MIN
from edge.sockets.control_socket import request
from edge.tick.inbox import is_in_force, is_urgent
from edge.tick.orders import FanMode, Mode

Request = dict[str, Any]
Fill = Callable[[argparse.ArgumentParser], None]


def _target(text: str) -> float | None:
    if text == "none":
        return None
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a temperature nor none") from None


def _name(text: str) -> str | None:
    return None if text == "none" else text


def _mode(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "mode",
        choices=[mode.value for mode in Mode],
        help="auto: heater and fan; heat: heater alone; fan_only: fan alone; off: neither; "
        "manual: as `greenhouse manual` set them",
    )


def _fan(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "fan_mode", choices=[mode.value for mode in FanMode], help="auto: the controller decides"
    )


def _reference(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "reference_c",
        metavar="DEGC|none",
        type=_target,
        help="temperature of the air [°C], or none: as configured",
    )


def _controller(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", type=_name, help="a name from `greenhouse demo --help`; none: as configured")


def _manual(parser: argparse.ArgumentParser) -> None:
    share = number(0.0, 1.0)
    parser.add_argument(
        "--heater-duty", type=share, default=0.0, help="heater, 0 to 1 of full power; default: 0"
    )
    parser.add_argument("--fan-on", type=int, choices=(0, 1), default=0, help="fan: 1 on, 0 off; default: 0")
    parser.add_argument("--led", type=share, default=0.0, help="light, 0 to 1 of full; default: 0")


def _maintenance(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "minutes",
        type=number(0.0, MAINTENANCE_MAX_MIN),
        help=f"minutes after which it ends by itself, up to {MAINTENANCE_MAX_MIN:g}; 0 ends it now",
    )


def _resend(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("first_seq", type=whole(1), help="number of the first tick")
    parser.add_argument("last_seq", type=whole(1), help="number of the last tick")


def _proposal(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("id", help="as `greenhouse ask` has printed it")


def _status(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print everything as JSON, for programs")


def _nothing(parser: argparse.ArgumentParser) -> None:
    pass


ORDERS: dict[str, tuple[str, str, Fill]] = {  # command -> request, help, arguments
    "status": ("status", "show what the rig measures, drives and was ordered to do", _status),
    "mode": ("set_mode", "choose what may run: auto, heat, fan_only, off, manual", _mode),
    "fan": ("set_fan_mode", "let the controller decide on the fan (auto), or on, off", _fan),
    "reference": ("set_reference", "set the temperature to hold, or none: as configured", _reference),
    "controller": ("set_controller", "change the controller while it runs", _controller),
    "manual": ("set_manual", "fix heater, fan and light until the mode changes", _manual),
    "emergency-stop": ("emergency_stop", "turn everything off, the fan too, until `release`", _nothing),
    "release": ("release_emergency_stop", "end an emergency stop", _nothing),
    "clear-trip": ("clear_trip", "end an over-temperature trip once its cause is gone", _nothing),
    "maintenance": (
        "maintenance",
        "turn everything off, the fan too: hands are inside",
        _maintenance,
    ),
    "confirm": ("confirm", "apply a proposal of `greenhouse ask`", _proposal),
    "undo": ("undo", "take back what was confirmed last", _nothing),
    "resend": ("resend", "publish recorded ticks over MQTT again", _resend),
}


def add_arguments(name: str, parser: argparse.ArgumentParser) -> None:
    """Arguments of one of ORDERS."""
    ORDERS[name][2](parser)
    add_socket(parser)


def run(arguments: argparse.Namespace) -> int:
    """Ask, print the answer; 1 when the daemon refuses."""
    name = ORDERS[arguments.command][0]
    not_asked = ("command", "socket", "run", "json")
    values = {key: value for key, value in vars(arguments).items() if key not in not_asked}
    message = {"do": name, **values}
    answer = request(socket_of(arguments, urgent=is_urgent(message)), message)
    if not answer.get("ok", False):
        print(f"{'warning' if is_in_force(answer) else 'refused'}: {answer.get('error', answer)}")
        return 1
    if name != "status":
        print("done")
    elif arguments.json:
        print(json.dumps(answer, indent=1))
    else:
        print("\n".join(status_lines(answer)))
    if warning := answer.get("warning"):
        print(f"warning: {warning}", file=sys.stderr)
    return 0
