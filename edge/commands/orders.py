"""Commands that ask the running daemon over its control socket, `greenhouse status`, `mode`, ..., and the
page that `status` prints.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from datetime import datetime
from pathlib import Path
from typing import Any

from edge.app.running_rigs import RunningRig
from edge.assistant.why.ask_history import reasons
from edge.commands.arguments import number, whole
from edge.commands.which_rig import add_socket, rigs_of, socket_of
from edge.core.errors import GreenhouseError, RequestError
from edge.core.hard_limits import MAINTENANCE_MAX_MIN, REFERENCE_MAX_C, REFERENCE_MIN_C
from edge.core.plain_text import plain
from edge.formats.owner import as_owner
from edge.sockets.client import request
from edge.sockets.stop_file import LEFT, StopFile
from edge.tick.inbox import is_in_force, is_urgent
from edge.tick.orders import FanMode, Mode
from edge.tick.standing_profile import profile_of

CLEAR_TRIP = "`greenhouse clear-trip` when the cause is gone"
# Stops that the board still holds and the daemon does not know of.
ENDED_BY = {
    "emergency_stop": "`greenhouse release` ends it",
    "maintenance": "`greenhouse maintenance 0` ends it",
}

OTHER_WAY = "say --socket PATH with the socket of a daemon that runs, or pull the heater's plug"
STOP_MAX_S = 3.0  # after which a daemon counts as one that does not answer

Json = Mapping[str, Any]


def status_lines(status: Json) -> list[str]:
    """Return the lines: alarms first, then what was measured, what the board drives and who decides."""
    operation, tick = status["operation"], status["tick"]
    lines = list(_alarms(status))
    if tick is None:
        return [*lines, "no tick has been made yet"]
    at = datetime.fromtimestamp(tick["utc"])
    rows = {
        "air": _reading(tick, "temp_air_c"),
        "reference": f"{_degrees(tick['reference_c'])}, {_reference_from(operation)}",
        "room": _reading(tick, "temp_ambient_c"),
        **_output_texts(status["echo"]),
        "mode": f"{operation['mode']}, fan {operation['fan_mode']}",
        "controller": _decider(tick, operation),
        "profile": _profile(operation),
        "asked": operation["steering"] and operation["steering"]["words"],
        "safety": "; ".join(dict.fromkeys(change["reason"] for change in tick["changes"])),
        "last tick": f"{tick['seq']} at {at:%H:%M:%S}, every {tick['step_s']:g} s",
        "why": "" if _is_stopped(operation) else " ".join(reasons(tick["why"])),
    }
    return [*lines, *(f"{name:<11s}{text}" for name, text in rows.items() if text)]


def _alarms(status: Json) -> Iterator[str]:
    operation, tick, echo = status["operation"], status["tick"], status["echo"]
    if operation["emergency_stop"]:
        yield "EMERGENCY STOP: everything is off until `greenhouse release`"
    until = operation["maintenance_until_utc"]
    if until is not None:
        yield f"MAINTENANCE until {datetime.fromtimestamp(until):%Y-%m-%d %H:%M}: everything is off"
    if status["trips"]:
        yield f"TRIPPED: {', '.join(map(str, status['trips']))}; {CLEAR_TRIP}"
    if echo is not None and echo["tripped"]:
        cause = echo["trip_cause"]
        known = {"emergency_stop": operation["emergency_stop"], "maintenance": until is not None}
        if not known.get(cause, False):
            yield f"THE BOARD HAS TRIPPED: {cause}; {ENDED_BY.get(cause, CLEAR_TRIP)}"
    if foreign := status.get("foreign_board"):
        yield f"ANOTHER BOARD is not driven: {foreign}; `greenhouse board accept` if it is the right one"
    elif tick is not None and not status["link_up"]:
        yield "THE BOARD IS SILENT: it turns its heater off by itself"


def _is_stopped(operation: Json) -> bool:
    """Return True while a person's stop holds everything off, so that no plan is carried out."""
    return bool(operation["emergency_stop"]) or operation["maintenance_until_utc"] is not None


def _output_texts(echo: Json | None) -> dict[str, str]:
    if echo is None:
        return {"heater": "not known: the board does not say", "fan": "not known: the board does not say"}
    return {
        "heater": f"{echo['heater_duty']:.2f} of full power",
        "fan": "on" if echo["fan_on"] else "off",
        "LED": f"{echo['led']:.2f} of full light" if echo["led"] else "",
        "water valve": "open" if echo["valve_open"] else "",
    }


def _reading(tick: Json, key: str) -> str:
    reading = tick["readings"].get(key)
    if reading is None or reading["value"] is None:
        return f"not known ({'absent' if reading is None else reading['quality']})"
    return f"{_degrees(reading['value'])} ({reading['quality']})"


def _reference_from(operation: Json) -> str:
    if operation["reference_c"] is not None:
        return f"set by hand to {_degrees(operation['reference_c'])}"
    if operation["steering"] and operation["steering"]["daily"]:
        return "as asked for in words"
    return "of the profile" if "profile" in operation else "as configured"


def _profile(operation: Json) -> str:
    profile = profile_of(operation)
    return "" if profile is None else profile.in_words()


def _decider(tick: Json, operation: Json) -> str:
    chosen = str(operation["controller"])
    return chosen if tick["controller"] == chosen else f"{chosen}; {tick['controller']} decided the last step"


def _degrees(value: float | None) -> str:
    return "not known" if value is None else f"{value:.1f} °C"


Request = dict[str, Any]
Arguments = Mapping[str, Mapping[str, Any]]  # name -> options of `add_argument`


def _target(text: str) -> float | None:
    return None if text == "none" else number(REFERENCE_MIN_C, REFERENCE_MAX_C)(text)


def _name(text: str) -> str | None:
    return None if text == "none" else text


_SHARE = number(0.0, 1.0)
_PROPOSAL: Arguments = {"id": {"help": "as `greenhouse ask` has printed it"}}
_WHY: Arguments = {"--why": {"default": "", "help": "your reason, for `greenhouse memory`"}}
_MODE: Arguments = {
    "mode": {
        "choices": [mode.value for mode in Mode],
        "help": "auto: heater and fan; heat: heater alone; fan_only: fan alone; off: neither; "
        "manual: as `greenhouse manual` set them",
    }
}
_FAN: Arguments = {
    "fan_mode": {"choices": [mode.value for mode in FanMode], "help": "auto: the controller decides"}
}
_REFERENCE: Arguments = {
    "reference_c": {
        "metavar": "DEGC|none",
        "type": _target,
        "help": "temperature of the air [°C], or none: as configured",
    }
}
_CONTROLLER: Arguments = {
    "name": {"type": _name, "help": "a name from `greenhouse demo --help`; none: as configured"}
}
_MANUAL: Arguments = {
    "--heater-duty": {"type": _SHARE, "default": 0.0, "help": "heater, 0 to 1 of full power; default: 0"},
    "--fan-on": {"type": int, "choices": (0, 1), "default": 0, "help": "fan: 1 on, 0 off; default: 0"},
    "--led": {"type": _SHARE, "default": 0.0, "help": "light, 0 to 1 of full; default: 0"},
}
_MAINTENANCE: Arguments = {
    "minutes": {
        "type": number(0.0, MAINTENANCE_MAX_MIN),
        "help": f"minutes after which it ends by itself, up to {MAINTENANCE_MAX_MIN:g}; 0 ends it now",
    }
}
_RESEND: Arguments = {
    "first_seq": {"type": whole(1), "help": "number of the first tick"},
    "last_seq": {"type": whole(1), "help": "number of the last tick"},
}
_STATUS: Arguments = {"--json": {"action": "store_true", "help": "print everything as JSON, for programs"}}
ORDERS: dict[str, tuple[str, str, Arguments]] = {  # command -> request, help, arguments
    "status": ("status", "show what the rig measures, drives and was ordered to do", _STATUS),
    "mode": ("set_mode", "choose what may run: auto, heat, fan_only, off, manual", _MODE),
    "fan": ("set_fan_mode", "let the controller decide on the fan (auto), or on, off", _FAN),
    "reference": ("set_reference", "set the temperature to hold, or none: as configured", _REFERENCE),
    "controller": ("set_controller", "change the controller while it runs", _CONTROLLER),
    "manual": ("set_manual", "fix heater, fan and light until the mode changes", _MANUAL),
    "emergency-stop": ("emergency_stop", "turn everything off, the fan too, until `release`", {}),
    "release": ("release_emergency_stop", "end an emergency stop", {}),
    "clear-trip": ("clear_trip", "end an over-temperature trip once its cause is gone", {}),
    "maintenance": (
        "maintenance",
        "turn everything off, the fan too: hands are inside",
        _MAINTENANCE,
    ),
    "confirm": ("confirm", "apply a proposal of `greenhouse ask`", _PROPOSAL),
    "discard": ("discard", "put a proposal of `greenhouse ask` away", {**_PROPOSAL, **_WHY}),
    "undo": ("undo", "take back what was confirmed last", _WHY),
    "resend": ("resend", "publish recorded ticks over MQTT again", _RESEND),
}


def add_arguments(name: str, parser: argparse.ArgumentParser) -> None:
    """Arguments of one of ORDERS."""
    for argument, options in ORDERS[name][2].items():
        parser.add_argument(argument, **options)
    add_socket(parser)


def run(arguments: argparse.Namespace) -> int:
    """Ask, print the answer; 1 when the daemon refuses, or when one of several has not stopped."""
    name = ORDERS[arguments.command][0]
    not_asked = ("command", "socket", "rig", "run", "json")
    values = {key: value for key, value in vars(arguments).items() if key not in not_asked}
    message = {"do": name, **values}
    try:
        if name == "emergency_stop" and arguments.socket is None:
            return _stop_all(rigs_of(arguments, hint=""))
        answer = request(socket_of(arguments, urgent=is_urgent(message)), message)
    except RequestError as error:
        if name != "emergency_stop":
            raise
        raise RequestError(f"NOTHING WAS STOPPED: {error}; {OTHER_WAY}") from None
    if name != "status" or not answer.get("ok", False):
        return print_answer(answer)
    print(json.dumps(answer, indent=1) if arguments.json else "\n".join(status_lines(answer)))
    return 0


def _stop_all(rigs: Sequence[RunningRig]) -> int:
    """Stop all rigs at the same time, and print each outcome as it comes; 1 unless all have stopped."""
    code = 0
    with ThreadPoolExecutor(len(rigs)) as pool:
        asked = {pool.submit(_stop, rig): rig.name or rig.socket for rig in rigs}
        for done in as_completed(asked):
            stopped, text = done.result()
            code = code if stopped else 1
            print(f"{plain(asked[done])}: {plain(text, 400)}", flush=True)
    return code


def _stop(rig: RunningRig) -> tuple[bool, str]:
    """Return whether a daemon confirms its stop, and what is known of it; never raises."""
    try:
        answer = request(Path(rig.socket), {"do": "emergency_stop"}, STOP_MAX_S)
    except GreenhouseError as error:
        if not rig.stops:
            return False, f"NOT STOPPED: {error}"
        try:
            with as_owner(rig.entry):  # its owner could have named any folder of root's
                StopFile(Path(rig.stops)).leave("the command line")
        except OSError as problem:
            return False, f"NOT STOPPED: {error}; and no stop could be left: {problem}"
        return False, LEFT
    warning = answer.get("error") or answer.get("warning")
    text = "stopped" if is_in_force(answer) else "NOT STOPPED"
    return bool(answer.get("ok")), f"{text}: {warning}" if warning else text


def print_answer(answer: dict[str, Any]) -> int:
    """Print the daemon's answer to an order; 1 where it refuses, or where the disk has not taken it."""
    if not answer.get("ok", False):
        print(f"{'warning' if is_in_force(answer) else 'refused'}: {answer.get('error', answer)}")
        return 1
    print(answer.get("message", "done"))
    if warning := answer.get("warning"):
        print(f"warning: {warning}", file=sys.stderr)
    return 0
