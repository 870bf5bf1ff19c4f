"""Lock-step: the host owns time. Bytes are counted on both sides, because a pty delivers when it likes."""

import math
import select
import time
from collections.abc import Mapping
from typing import Any

from firmware_protocol.virtual_board.control import ControlClient, ControlRequestError
from firmware_protocol.virtual_board.device import Device
from firmware_protocol.virtual_board.port import PseudoTerminal

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
