"""`greenhouse calibrate`: correct a sensor by one or two states whose true value is known."""

import argparse
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from edge.commands.arguments import add_actions, number
from edge.commands.orders import print_answer
from edge.commands.which_rig import add_socket, socket_of
from edge.config.settings import SensorCalibration
from edge.core.errors import RequestError
from edge.core.names import SIGNALS
from edge.sockets.client import request
from edge.tick.calibration import amount, formula

ACTIONS = {
    "show": ("", "print how each sensor is calibrated, and its points"),
    "point": ("calibrate_point", "take the mean of the last minute's raw readings beside the true value"),
    "apply": (
        "apply_calibration",
        "correct it by its points: one moves the offset, two the gain too",
    ),
    "discard": ("discard_points", "drop the points of a sensor"),
    "reset": ("reset_calibration", "calibrate the sensor as configured again"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command and its actions."""
    for name, action in add_actions(parser, {name: text for name, (_, text) in ACTIONS.items()}).items():
        if name != "show":
            action.add_argument("signal", choices=SIGNALS, metavar="SIGNAL", help=", ".join(SIGNALS))
        if name == "point":
            units = dict.fromkeys(signal.unit for signal in SIGNALS.values())
            text = f"in the signal's unit: {', '.join(units)} (1: a share)".replace("%", "%%")
            action.add_argument("true_value", type=number(-1e5, 1e5), help=text)
        add_socket(action)


def run(arguments: argparse.Namespace) -> int:
    """Ask the daemon; 1 where it refuses. Errors: RequestError"""
    socket, kind = socket_of(arguments), ACTIONS[arguments.action][0]
    if not kind:
        answer = request(socket, {"do": "status"})
        if (shown := answer.get("calibration")) is None:
            raise RequestError(str(answer.get("error", "this daemon knows no calibrations: restart it")))
        print("\n".join(line for signal, state in shown.items() for line in state_lines(signal, state)))
        return 0
    order: dict[str, Any] = {"do": kind, "signal": arguments.signal}
    if arguments.action == "point":
        order["true_value"] = arguments.true_value
    answer = request(socket, order)
    code = print_answer(answer)
    if state := answer.get("calibration", {}).get(arguments.signal):
        print("\n".join(state_lines(arguments.signal, state)))
    return code


def state_lines(signal: str, state: Mapping[str, Any]) -> Iterator[str]:
    """Yield how a sensor is calibrated, as the status has it; then its points and what they would bring."""
    since = state["since_utc"]
    origin = "as configured" if since is None else f"calibrated {_at(since)}"
    yield f"{signal:<14}reads {_reading_text(signal, state['reads'])}, {_formula(signal, state)}, {origin}"
    for point in state["points"]:
        raw, noise, true = (amount(signal, point[key]) for key in ("raw", "noise", "true_value"))
        yield f"  point of {_at(point['utc'])}: {true} is true, raw {raw}, noise {noise}"
    if state["following"] is not None:
        after = f"{_reading_text(signal, state['will_read'])}, {_formula(signal, state['following'])}"
        yield f"  will read {after} after `greenhouse calibrate apply {signal}`"


def _formula(signal: str, values: Mapping[str, Any]) -> str:
    return formula(signal, SensorCalibration(values["offset"], values["gain"]))


def _reading_text(signal: str, value: float | None) -> str:
    return "nothing good" if value is None else amount(signal, value)


def _at(utc: float) -> str:
    return f"{datetime.fromtimestamp(utc):%Y-%m-%d %H:%M}"
