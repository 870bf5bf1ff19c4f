"""Lock-step: the host owns time over the control socket, which is not part of the wire protocol."""

import json
import math
import select
import socket
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from firmware_protocol.virtual_board.device import Device
from firmware_protocol.virtual_board.port import PseudoTerminal

Handler = Callable[[Mapping[str, Any], "ControlClient"], Mapping[str, Any]]

_LONGEST_LINE = 65536


class ControlRequestError(Exception):
    """A request that can't be carried out; its text goes back as {"error": text}."""


class ControlClient:
    """One connection and the bytes of a line not yet whole."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self._rest = b""

    def lines(self) -> list[bytes] | None:
        """Whole lines that have arrived; None when the other side has gone."""
        try:
            data = self.connection.recv(_LONGEST_LINE)
        except OSError:
            return None
        *lines, self._rest = (self._rest + data).split(b"\n")
        return lines if data and len(self._rest) < _LONGEST_LINE else None

    def answer(self, reply: Mapping[str, Any]) -> None:
        """Send one line; a client that has gone misses it."""
        try:
            self.connection.sendall(json.dumps(reply).encode() + b"\n")
        except OSError:
            return


class BoardControlSocket:
    """Listens on a Unix socket that only its owner can use, and serves those that connect."""

    def __init__(self, path: Path, handler: Handler) -> None:
        self._path = path
        self._handler = handler
        self._clients: dict[socket.socket, ControlClient] = {}
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(path))
        path.chmod(0o600)
        self._listener.listen()

    @property
    def sockets(self) -> list[socket.socket]:
        """All to wait on."""
        return [self._listener, *self._clients]

    def serve(self, ready: socket.socket) -> None:
        """Do what a readable socket asks for."""
        if ready is self._listener:
            connection, _ = self._listener.accept()
            self._clients[connection] = ControlClient(connection)
            return
        client = self._clients[ready]
        lines = client.lines()
        if lines is None:
            del self._clients[ready]
            ready.close()
            return
        for line in lines:
            client.answer(self._reply(line, client))

    def _reply(self, line: bytes, client: ControlClient) -> Mapping[str, Any]:
        try:
            request = json.loads(line)
        except (ValueError, RecursionError) as error:
            return {"error": f"not JSON: {error}"}
        if not isinstance(request, dict):
            return {"error": "a request is a JSON object"}
        try:
            return self._handler(request, client)
        except ControlRequestError as error:
            return {"error": str(error)}

    def close(self) -> None:
        """Hang up on everybody and remove the socket."""
        for connection in self.sockets:
            connection.close()
        self._path.unlink(missing_ok=True)


PATIENCE_S = 2.0  # real time; bytes that are not here by then were never written
LATEST_S = 1e9


def advance(
    device: Device, port: PseudoTerminal, request: Mapping[str, Any], client: ControlClient
) -> Mapping[str, Any]:
    """Advance to `advance_to_s`; the answer is `{time_s, board_bytes, plugged}`.

    host_bytes : written by the host since its opening of the port; absent when it has none open
    device, opening : which port the host has open, and a number that tells one opening from another
    stop_on_bytes : come back as soon as the board has sent something

    It comes back early too when the plug is pulled or put in.
    """
    until_ms = milliseconds(_number(request, "advance_to_s", LATEST_S))
    device.receive(port.read())
    plugged = port.plugged and "host_bytes" in request
    if plugged:
        plugged = _is_this_one(port, request, client)
    if plugged:
        # Simulated time must not run ahead of bytes that are still in the pseudo-terminal.
        _take_host_bytes(device, port, int(_number(request, "host_bytes", 2**53)))
    stop_on_bytes = request.get("stop_on_bytes") is True
    while device.now_ms < until_ms:
        device.step(until_ms)
        sent = carry(device, port)
        if (sent and stop_on_bytes) or port.plugged == device.unplugged:
            break
    if follow_plug(device, port):
        plugged = False
    return {"time_s": device.now_ms / 1000, "board_bytes": port.bytes_out, "plugged": plugged}


def carry(device: Device, port: PseudoTerminal) -> bool:
    """Hand the host what the board has sent; whether there was something."""
    data = device.transmit()
    if data:
        port.write(data)
    return bool(data)


def follow_plug(device: Device, port: PseudoTerminal) -> bool:
    """Do to the port what the `unplug` fault says; whether that was a change."""
    if port.plugged != device.unplugged:
        return False
    if device.unplugged:
        port.unplug()
    else:
        port.plug()
    return True


def milliseconds(time_s: float) -> int:
    """Return the first whole millisecond not before `time_s`, divided too:
    else a host could wait for ever.
    """
    time_ms = math.ceil(time_s * 1000)
    return time_ms if time_ms / 1000 >= time_s else time_ms + 1


def _is_this_one(port: PseudoTerminal, request: Mapping[str, Any], client: ControlClient) -> bool:
    """Return whether this port is the one the host has open, and all of its bytes are from this opening.

    The first to speak takes the port. Another one has opened it before the board saw the first one close it:
    whose bytes are whose is not known, so it gets a hang-up, and a device of its own at its next try.
    """
    if request.get("device", port.device) != port.device:
        return False
    user = client, request.get("opening")
    if port.user is None:
        port.user = user
    elif port.user != user:
        port.plug()
        return False
    return True


def _take_host_bytes(device: Device, port: PseudoTerminal, host_bytes: int) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while port.bytes_in < host_bytes and time.monotonic() < deadline:
        select.select([port], [], [], deadline - time.monotonic())
        device.receive(port.read())
    if port.bytes_in != host_bytes:
        raise ControlRequestError(f"the host has written {host_bytes} bytes, {port.bytes_in} have come")


def _number(request: Mapping[str, Any], key: str, highest: float) -> float:
    value = request[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= highest:
        raise ControlRequestError(f"{key}: {value!r} is not a number in 0..{highest:g}")
    return value
