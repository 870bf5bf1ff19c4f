"""Wires a rig together from settings, runs its loop, and takes it apart again."""

import secrets
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge import operation as orders
from edge import state_file
from edge.board import Board
from edge.clock import Clock
from edge.controllers import registry
from edge.errors import RequestError
from edge.estimator import Estimator
from edge.inbox import Inbox, Reply, Request
from edge.loop import BoardLine, Loop, Rig
from edge.messages import TickRecord
from edge.models.arx_file import DEFAULT_PATH, read_arx
from edge.operation import Operation
from edge.reference import make_reference, zone_of
from edge.safety import SafetyMemory, memory_from_dict, memory_to_dict
from edge.sensor_health import SensorHealth
from edge.settings import CONTROLLERS, Settings
from edge.storage import Storage


@dataclass(frozen=True, slots=True)
class Standing:
    """What outlives the process."""

    operation: Operation
    memory: SafetyMemory
    broken: str  # why the state file could not be understood, "" when it could


def read_standing(path: Path, settings: Settings) -> Standing:
    """Standing orders and latched trips; an unreadable file means emergency stop, not a fresh start."""
    fresh = Operation(controller=settings.control.controller)
    try:
        values = state_file.read(path)
        if values is None:
            return Standing(fresh, SafetyMemory(), "")
        operation = orders.from_dict(values["operation"])
        if operation.controller not in CONTROLLERS:
            raise state_file.StateFileBroken(f"{path}: unknown controller {operation.controller!r}")
        return Standing(operation, memory_from_dict(values["safety"]), "")
    except (state_file.StateFileBroken, KeyError, TypeError, ValueError) as error:
        return Standing(orders.stopped(fresh), SafetyMemory(), str(error) or repr(error))
