"""The program's loop: the port, the control socket and, in real time, the clock."""

import select
import socket
import time
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from firmware_protocol.virtual_board.device import Device
from firmware_protocol.virtual_board.faults import FaultError, make_fault
from firmware_protocol.virtual_board.lockstep import (
    BoardControlSocket,
    ControlClient,
    ControlRequestError,
    advance,
    carry,
    follow_plug,
)
from firmware_protocol.virtual_board.port import PseudoTerminal


def truth(device: Device, port: PseudoTerminal) -> dict[str, Any]:
    """Chamber, pins, flows, meters and counters; times in s of simulated time, None: never."""
    plant = device.plant
    chamber = plant.truth(device.now_ms)
    return {
        "time_s": device.now_ms / 1000,
        "chamber": chamber,
        "energy": plant.chamber.energy(),
        # Between two looks too: a peak may be shorter than the time from one to the next.
        "hottest_air_c": max(plant.hottest_c, chamber["temp_air_c"]),
        "pins": {
            "heater_relay": plant.pins.heater_relay,
            "fan": plant.pins.fan,
            "led": plant.pins.led,
            "valve": plant.pins.valve,
            "cutoff_open": plant.pins.cutoff_open,
        },
        "heat_on": plant.heat,
        "fan_on": plant.fan,
        "heat_on_s": plant.heat_on_ms / 1000,
        "heater_pin_on_for_s": _since(plant.heater_pin_on_at_ms, device.now_ms),
        "heater_pin_last_on_s": _seconds(plant.last_on_ms["heater_relay"]),
        "last_on_s": {pin: _seconds(time_ms) for pin, time_ms in plant.last_on_ms.items()},
        "boots": [{"time_s": time_s, "cause": cause.name.lower()} for time_s, cause in device.boots],
        "boot_count": device.boot_count,
        "faults": [fault.name for fault in device.schedule.active],
        "plugged": port.plugged,
        "bytes": {
            "to_board": device.to_board.bytes_sent,
            "to_board_arrived": device.to_board.bytes_arrived,
            "to_host": device.to_host.bytes_sent,
            "to_host_arrived": device.to_host.bytes_arrived,
            "lost_at_port": port.bytes_lost,
        },
    }


def _since(start_ms: int | None, now_ms: int) -> float:
    return 0.0 if start_ms is None else (now_ms - start_ms) / 1000


def _seconds(time_ms: int | None) -> float | None:
    return None if time_ms is None else time_ms / 1000


REQUESTS: dict[str, tuple[str, ...]] = {  # what is asked, and what may be said beside it
    "advance_to_s": ("host_bytes", "device", "opening", "stop_on_bytes"),
    "fault": (),
    "clear_faults": (),
    "truth": (),
    "quit": (),
}


class Server:
    """A device behind a port and a control socket."""

    def __init__(
        self, device: Device, port: PseudoTerminal, control: Path, seed: int, real_time: bool
    ) -> None:
        self._device, self._port = device, port
        self._seed, self._injected = seed, 0
        self._started_s = time.monotonic() if real_time else None
        self._control = BoardControlSocket(control, self._handle)
        self._quit = False

    def run(self) -> None:
        """Serve until told to quit."""
        follow_plug(self._device, self._port)
        while not self._quit:
            wait_s = self._catch_up()
            sources: list[PseudoTerminal | socket.socket] = [*self._control.sockets]
            if self._port.plugged:
                sources.append(self._port)
            ready, _, _ = select.select(sources, [], [], wait_s)
            for source in ready:
                if isinstance(source, PseudoTerminal):
                    self._device.receive(source.read())
                else:
                    self._control.serve(source)

    def close(self) -> None:
        """Take device, symlink and control socket away."""
        self._port.unplug()
        self._control.close()

    def _catch_up(self) -> float | None:
        """Bring the device to real time; how long nothing will happen [s], None: until told."""
        if self._started_s is None:
            return None
        now_ms = int((time.monotonic() - self._started_s) * 1000)
        self._port.user = self._port.user or self  # in real time there is always somebody to send to
        while self._device.next_step_ms <= now_ms:
            self._device.step(now_ms)
            carry(self._device, self._port)
            follow_plug(self._device, self._port)
        return max(0.0, self._device.next_step_ms / 1000 - (time.monotonic() - self._started_s))

    def _handle(self, request: Mapping[str, Any], client: ControlClient) -> Mapping[str, Any]:
        match _command_word(request):
            case "advance_to_s":
                if self._started_s is not None:
                    raise ControlRequestError("this board runs in real time")
                return advance(self._device, self._port, request, client)
            case "fault":
                self._inject(request["fault"])
            case "clear_faults":
                self._device.clear_faults()
            case "truth":
                return truth(self._device, self._port)
            case "quit":
                self._quit = True
        follow_plug(self._device, self._port)
        return {"time_s": self._device.now_ms / 1000}

    def _inject(self, entry: object) -> None:
        self._injected += 1
        seed = f"{self._seed}/injected {self._injected}"
        try:
            self._device.inject(make_fault(entry, now_ms=self._device.now_ms, seed=seed, place="fault"))
        except FaultError as error:
            raise ControlRequestError(str(error)) from error


def _command_word(request: Mapping[str, Any]) -> str:
    asked = [key for key in request if key in REQUESTS]
    if len(asked) == 1:
        unknown = [key for key in request if key not in (*asked, *REQUESTS[asked[0]])]
        known: list[str] = list(REQUESTS[asked[0]])
    else:
        unknown, known = list(request), list(REQUESTS)
    if len(asked) == 1 and not unknown:
        return asked[0]
    close = [match for key in unknown for match in get_close_matches(key, known, n=1)]
    hint = f"nearest known: {close[0]!r}" if close else f"known: {known}"
    raise ControlRequestError(f"one of {list(REQUESTS)} a line, not {list(request)}; {hint}")
