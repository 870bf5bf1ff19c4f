"""Which rig a command speaks to: the configured one, or a demo where this machine has no rig."""

import argparse
import os
import sys
from pathlib import Path

from edge.app.demo_folders import SOCKET, last_history, running_demos
from edge.config.settings import ControlSocketSettings, HistorySettings
from edge.core.errors import ConfigError, DataError, RequestError

RIG_CONFIG = Path("/etc/greenhouse/edge.yaml")


def add_socket(parser: argparse.ArgumentParser) -> None:
    """Add --socket."""
    parser.add_argument(
        "--socket",
        type=Path,
        help="the daemon's control socket; default: this machine's rig, or the demo where there is no rig",
    )


def socket_of(arguments: argparse.Namespace, urgent: bool = False) -> Path:
    """Return the socket to ask, and say on standard error when a demo is behind it.

    urgent : an order to stop goes to the rig at once, whatever else runs
    Errors : RequestError that names the sockets where it is not certain which rig is meant
    """
    if arguments.socket is not None:
        return Path(arguments.socket)
    rig = rig_socket()
    has_rig = rig.exists() or RIG_CONFIG.exists()
    if urgent and has_rig:
        return rig
    demos = [folder / SOCKET for folder in running_demos()]
    if not demos and not has_rig:
        raise RequestError(f"no daemon listens at {rig}; `greenhouse demo` runs one without a rig")
    if not demos:
        return rig
    candidates = [rig, *demos] if has_rig else demos
    if len(candidates) > 1:
        names = " or ".join(f"--socket {path}" for path in candidates)
        raise RequestError(f"more than one rig on this machine: say {names}")
    print(f"(the demo at {demos[0]}, not a real rig)", file=sys.stderr)
    return demos[0]


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
    if usual.exists() or not os.access(RIG_CONFIG, os.R_OK):
        return usual
    from edge.config import loading as config  # late: a stop on a usual rig does not wait for YAML

    try:
        return Path(config.load(RIG_CONFIG).control_socket.path)
    except ConfigError:
        return usual
