"""Which rig a command speaks to: the configured one, or a demo where this machine has no rig."""

import argparse
import os
import sys
from pathlib import Path

from edge.app.running_rigs import RunningRig, known_rigs, last_history
from edge.config.settings import ControlSocketSettings, HistorySettings
from edge.core.errors import ConfigError, DataError, RequestError
from edge.core.plain_text import plain, quote
from edge.sockets.client import listens

RIG_CONFIG = Path("/etc/greenhouse/edge.yaml")
RIG_VARIABLE = "GREENHOUSE_RIG"
DEMO_HINT = "; `greenhouse demo` runs one without a rig"


def add_socket(parser: argparse.ArgumentParser) -> None:
    """Add --socket and --rig."""
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--socket",
        type=Path,
        help="the daemon's control socket; default: this machine's rig, or the demo where there is no rig",
    )
    which.add_argument(
        "--rig", metavar="NAME", help=f"name of a running rig, its mqtt.rig; default: ${RIG_VARIABLE}, if set"
    )


def socket_of(arguments: argparse.Namespace, urgent: bool = False) -> Path:
    """Return the socket to ask, and say on standard error when a demo is behind it.

    urgent : demos do not make it uncertain which rig is meant
    Errors : RequestError that names the rigs where it is not certain which one is meant
    """
    rigs = rigs_of(arguments)
    if urgent and not all(rig.is_demo for rig in rigs):
        rigs = [rig for rig in rigs if not rig.is_demo]
    if len(rigs) > 1:
        known = ", ".join(f"{rig.name or 'its name is not known'} ({rig.socket})" for rig in rigs)
        raise RequestError(f"more than one rig on this machine, say --rig or --socket: {plain(known, 1000)}")
    if rigs[0].is_demo:
        print(f"(the demo at {rigs[0].socket}, not a real rig)", file=sys.stderr)
    return Path(rigs[0].socket)


def rigs_of(arguments: argparse.Namespace, hint: str = DEMO_HINT) -> list[RunningRig]:
    """Return the selected rigs; without a selection all that run, and this machine's rig even while down.

    Errors : RequestError where there is none, with the hint where none was named
    """
    if arguments.socket is not None:
        return [RunningRig("", str(arguments.socket))]
    rig = rig_socket()
    found = [each for each in known_rigs() if listens(Path(each.socket)) or each.socket == str(rig)]
    if name := getattr(arguments, "rig", None) or os.environ.get(RIG_VARIABLE):
        if selected := [each for each in found if each.name == name]:
            return selected
        known = ", ".join(sorted({each.name for each in found})) or "none"
        raise RequestError(f"no rig named {quote(name)} runs on this machine; running: {plain(known, 1000)}")
    is_shut = os.access(rig.parent, os.F_OK) and not os.access(rig.parent, os.X_OK)  # to this user
    is_here = is_shut or any(os.access(place, os.F_OK) for place in (rig, RIG_CONFIG))
    if is_here and all(each.socket != str(rig) for each in found):
        found.insert(0, RunningRig("", str(rig)))
    if not found:
        raise RequestError(f"no daemon listens at {rig}{hint}")
    return found


def history_of(history: Path | None) -> Path:
    """Return the database to read: `history`, else the rig's, else that of the last demo.

    Errors : DataError that says how to record one
    """
    if history is not None:
        return history
    usual = Path(HistorySettings().path)
    if usual.exists():
        return usual
    if (demo := last_history()) is not None:
        print(f"(the demo's history, {demo}; a rig would have {usual})", file=sys.stderr)
        return demo
    raise DataError(f"{usual}: there is no history yet; `greenhouse demo` records one without a rig")


def rig_socket() -> Path:
    """Return the socket that the rig's configuration names, the default where it cannot be read."""
    usual = Path(ControlSocketSettings().path)
    if os.access(usual, os.F_OK) or not os.access(RIG_CONFIG, os.R_OK):
        return usual
    from edge.config import loading as config  # late: a stop on a usual rig does not wait for YAML

    try:
        return Path(config.load(RIG_CONFIG).control_socket.path)
    except ConfigError:
        return usual
