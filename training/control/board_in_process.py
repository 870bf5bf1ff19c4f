"""The virtual board in the daemon's own process: same device, same bytes, nothing between.

A run over a pseudo-terminal gives the same columns (tests/training/test_control_runs.py) and takes longer.
"""

import math
import select
from pathlib import Path

from edge.board.sim_clock import SLICE_S, START_UTC
from edge.core.clock import Port
from firmware_protocol.messages import ResetCause
from firmware_protocol.virtual_board.board_config import RIG_PARTS, BoardConfig
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.core import BoardCore
from firmware_protocol.virtual_board.device import Device
from firmware_protocol.virtual_board.lockstep import milliseconds
from firmware_protocol.virtual_board.plant import Plant
from firmware_protocol.virtual_board.store import Eeprom

NO_DESCRIPTOR = -1


def make_device(seed: int, chamber: Path | None = None) -> Device:
    """A board that was just switched on. chamber : YAML that changes parameters or effects of the box"""
    plant = Plant(Chamber(*load(chamber), seed), RIG_PARTS)
    return Device(_boot, plant, Eeprom(None), [])


class InProcessBoard:
    """The device's time and line: a `Clock` of edge/core that opens a `WirePort` of edge/board."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.bytes_in = self.bytes_out = 0
        self._arrived = bytearray()
        self._now_s = device.now_ms / 1000

    def now(self) -> float:
        """Simulated time since the board's start [s]."""
        return self._now_s

    def utc(self) -> float:
        """As `edge.board.sim_clock.SimClock`'s."""
        return START_UTC + self._now_s

    def wait(self, port: Port | None, wake: int | None, until_s: float) -> None:
        """Let the board advance to `until_s`, or until it has sent something or `wake` is readable."""
        while not (self._now_s >= until_s or (port is not None and self._arrived) or _readable(wake)):
            self._advance(min(until_s, self._now_s + SLICE_S), stop_on_bytes=port is not None)

    def _advance(self, to_s: float, stop_on_bytes: bool) -> None:
        # As lock-step does it: asked in whole milliseconds, told in the host's own number.
        asked_ms = milliseconds(math.ceil(to_s * 1000 - 1e-3) / 1000)
        device = self.device
        while device.now_ms < asked_ms:
            device.step(asked_ms)
            data = device.transmit()
            self._arrived += data
            if data and stop_on_bytes:
                break
        self._now_s = max(device.now_ms / 1000, to_s if device.now_ms >= asked_ms else self._now_s)

    def open(self, path: str, baudrate: int) -> "InProcessBoard":
        """The port: there is only one."""
        return self

    def fileno(self) -> int:
        """Nothing that the kernel knows."""
        return NO_DESCRIPTOR

    def read(self) -> bytes:
        """All bytes that have arrived, maybe none."""
        data = bytes(self._arrived)
        self._arrived.clear()
        self.bytes_in += len(data)
        return data

    def write(self, data: bytes) -> None:
        """The board hears them now."""
        self.bytes_out += len(data)
        self.device.receive(data)

    def close(self) -> None:
        """The board goes on by itself."""


def _boot(persistent: bytes, cause: ResetCause, boot_count: int) -> BoardCore:
    return BoardCore(BoardConfig(), persistent, cause, boot_count)


def _readable(descriptor: int | None) -> bool:
    return descriptor is not None and bool(select.select([descriptor], [], [], 0)[0])
