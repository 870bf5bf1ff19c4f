"""`greenhouse forget-discovery`: take a rig that is no more out of Home Assistant and off the broker."""

import argparse
from pathlib import Path

from edge.commands.arguments import add_config
from edge.config import loading as config
from edge.core.errors import RequestError
from edge.mqtt import telemetry
from edge.sockets.client import request


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_config(parser)


def run(arguments: argparse.Namespace) -> int:
    """0 when the broker has taken it. Errors: RequestError, also while the rig's daemon runs."""
    settings = config.load(arguments.config)
    if _is_running(Path(settings.control_socket.path)):
        raise RequestError("the daemon runs and would announce itself again; stop it first")
    telemetry.remove(settings)
    print(f"{settings.mqtt.rig}: taken off {settings.mqtt.host}:{settings.mqtt.port}")
    return 0


def _is_running(socket: Path) -> bool:
    try:
        request(socket, {"do": "status"})
    except RequestError:
        return False
    return True
