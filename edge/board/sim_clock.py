"""The host's side of lock-step: the simulated board owns time, which moves only while the loop waits."""

import array
import fcntl
import json
import math
import os
import select
import socket
import termios
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edge.core.clock import Port
from edge.core.errors import GreenhouseError

START_UTC = 1_767_225_600.0  # 2026-01-01T00:00:00Z; the same at every run, so that runs can be compared
SLICE_REAL_S = 0.1  # real time between two looks at the wake descriptor
SLICE_S = 10.0  # simulated time between two looks, however fast: some milliseconds of real time
PATIENCE_S = 30.0  # real time the board process may take for an answer
DELIVERY_S = 30.0  # real time a pty may take to deliver: a kernel thread does it, and may starve
PTY_HOLDS = 2048  # bytes a pty surely hands over at once


class BoardProcessGone(GreenhouseError):
    """The virtual board's process does not answer; the text names its control socket."""


class SimClock:
    """A `Clock` that asks the virtual board's control socket to advance.

    speed : simulated seconds per real second; None: as fast as it goes
    Errors : BoardProcessGone, from every method that talks to the board
    """

    def __init__(
        self, control_path: str | Path, speed: float | None = None, start_utc: float = START_UTC
    ) -> None:
        self._path = str(control_path)
        self._speed = speed
        self._start_utc = start_utc
        self._unanswered = 0
        self._now_s = 0.0
        self._board_bytes = 0
        self._port: Port | None = None
        self._device = ""
        self._opening = 0
        self._gone = False
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(PATIENCE_S)
        try:
            self._socket.connect(self._path)
        except OSError as error:
            self._socket.close()
            raise BoardProcessGone(f"no virtual board listens at {self._path}: {error}") from error
        self._answers = self._socket.makefile("rb")
        self._now_s = float(self.request({"advance_to_s": 0})["time_s"])
        self._anchor = (time.monotonic(), self._now_s)

    def now(self) -> float:
        """Return the simulated time since the board's start [s]."""
        return self._now_s

    def utc(self) -> float:
        """Seconds since 1970, moving with the simulated time."""
        return self._start_utc + self._now_s

    def wait(self, port: Port | None, wake: int | None, until_s: float) -> None:
        """Let the board advance to `until_s`, or until it has sent something or `wake` is readable."""
        if port is not self._port:
            self._new_port(port)
        while not (self._now_s >= until_s or self._bytes_pending() or _readable(wake)):
            slice_s = SLICE_S if self._speed is None else min(SLICE_S, SLICE_REAL_S * self._speed)
            self._advance(min(until_s, self._now_s + slice_s))
            self._pace(wake)

    def inject(self, **fault: Any) -> None:
        """Start a fault of the virtual board: `inject(name="mute", duration_s=5)`."""
        self.request({"fault": fault})

    def truth(self) -> Mapping[str, Any]:
        """Return the true state of the simulated greenhouse."""
        return self.request({"truth": True})

    def quit(self) -> None:
        """End the board process, and this connection."""
        self.request({"quit": True})
        self.close()

    def close(self) -> None:
        """Give the connection back; the board stands still."""
        self._answers.close()
        self._socket.close()

    def request(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        """Ask the board over its control socket. Errors: BoardProcessGone, GreenhouseError (a refusal)."""
        try:
            self._unanswered += 1
            self._socket.sendall(json.dumps(request).encode() + b"\n")
            line = b""
            while self._unanswered:  # a Ctrl-C may have left an older answer unread
                line = self._answers.readline()
                self._unanswered -= 1
        except (OSError, ValueError) as error:
            raise BoardProcessGone(f"the virtual board at {self._path} has gone: {error}") from error
        if not line:
            raise BoardProcessGone(f"the virtual board at {self._path} has gone")
        answer: Mapping[str, Any] = json.loads(line)
        if "error" in answer:
            raise GreenhouseError(f"{self._path}: {answer['error']}")
        return answer

    def _new_port(self, port: Port | None) -> None:
        """Count from 0: a port that was opened again is a new one."""
        self._port = port
        self._opening += 1
        self._board_bytes = 0
        self._gone = False
        if port is not None:
            try:
                self._device = os.ttyname(port.fileno())
            except OSError:  # hung up between its opening and now
                self._gone = True

    def _bytes_pending(self) -> bool:
        """Return whether the port has something to read: bytes, or the news that it was unplugged."""
        return self._port is not None and (self._gone or self._board_bytes > self._port.bytes_in)

    def _advance(self, to_s: float) -> None:
        asked_s = math.ceil(to_s * 1000 - 1e-3) / 1000  # the board counts ms: 0.1 + 0.2 s is 300
        request: dict[str, Any] = {"advance_to_s": asked_s}
        if self._port is not None:
            request |= {"host_bytes": self._port.bytes_out, "stop_on_bytes": True}
            request |= {"device": self._device, "opening": self._opening}
        answer = self.request(request)
        reached_s = float(answer["time_s"])
        self._now_s = max(reached_s, to_s if reached_s >= asked_s else self._now_s)
        if self._port is None:
            return
        self._gone = not answer["plugged"]
        if not self._gone:
            self._board_bytes = int(answer["board_bytes"])
            _await_delivery(self._port, self._board_bytes - self._port.bytes_in)

    def _pace(self, wake: int | None) -> None:
        """Sleep until real time has caught up with simulated time."""
        if self._speed is None:
            return
        real_s, sim_s = self._anchor
        ahead_s = real_s + (self._now_s - sim_s) / self._speed - time.monotonic()
        if ahead_s > 0:
            select.select([] if wake is None else [wake], [], [], ahead_s)
        elif ahead_s < -1.0:  # this machine is too slow, or was suspended: don't rush to catch up
            self._anchor = (time.monotonic(), self._now_s)


def _readable(descriptor: int | None) -> bool:
    return descriptor is not None and bool(select.select([descriptor], [], [], 0)[0])


def _await_delivery(port: Port, count: int) -> None:
    """Wait until `count` bytes can be read: a pty hands them over a little after they were written."""
    if count <= 0:
        return
    waiting = array.array("i", [0])
    deadline = time.monotonic() + DELIVERY_S
    while time.monotonic() < deadline:
        try:
            fcntl.ioctl(port.fileno(), termios.FIONREAD, waiting)
        except OSError:  # the board process has died: the port says so when it is read
            return
        if waiting[0] >= min(count, PTY_HOLDS):
            return
        time.sleep(0.0001)
    raise GreenhouseError(f"the serial port holds {waiting[0]} of {count} bytes that the board has sent")
