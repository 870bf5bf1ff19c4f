"""What is really so, for tests: no part of the wire protocol."""

from typing import Any

from firmware_protocol.virtual_board.device import Device
from firmware_protocol.virtual_board.port import PseudoTerminal


def truth(device: Device, port: PseudoTerminal) -> dict[str, Any]:
    """Chamber, pins, flows, meters and counters; times in s of simulated time, None: never."""
    plant = device.plant
    chamber = plant.truth(device.now_ms)
    return {
        "time_s": device.now_ms / 1000,
        "chamber": chamber,
        "energy": plant.chamber.energy(),
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
