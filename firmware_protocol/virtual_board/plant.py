"""Between the board's pins and the chamber: relays and fan as they really are, and a meter on them."""

import math
from collections.abc import Mapping, Set
from typing import Protocol

from firmware_protocol.messages import Capability
from firmware_protocol.virtual_board.core import Pins

ACTUATOR_PINS = ("heater_relay", "fan", "led", "valve")
FAN_RPM = 2800.0  # of a fan that turns

_SENSORS = {
    "rel_humidity_pct": Capability.HUMIDITY,
    "co2_ppm": Capability.CO2,
    "light": Capability.LIGHT,
    "soil_moisture": Capability.SOIL_MOISTURE,
    "tank_level": Capability.TANK_LEVEL,
    "temp_ambient_c": Capability.TEMP_AMBIENT,
}


class ChamberModel(Protocol):
    """The box: `chamber.ChamberModel`."""

    def step(self, dt_s: float, heater_power_fraction: float, fan: bool, led: float, valve: bool) -> None: ...
    def sense(self) -> dict[str, float]: ...
    def truth(self) -> dict[str, float]: ...
    def energy(self) -> dict[str, float]: ...


class Plant:
    """A chamber driven by pins. It is stepped when a flow changes or a sensor is read, so always exactly."""

    def __init__(self, chamber: ChamberModel, parts: Capability) -> None:
        self.chamber = chamber
        self._absent = {signal for signal, part in _SENSORS.items() if not part & parts}
        self._has_tacho = bool(parts & Capability.FAN_TACHO)
        has_cutoff = bool(parts & Capability.HEATER_CUTOFF)
        self.reset_pins = Pins(heater_relay=False, fan=False, led=0.0, valve=False, cutoff_open=has_cutoff)
        self.pins = self.reset_pins
        self.heat = self.fan = False  # what flows
        self.heater_pin_on_at_ms: int | None = None  # on since then
        self.last_on_ms: dict[str, int | None] = dict.fromkeys(ACTUATOR_PINS)  # until then at least
        self.heat_on_ms = 0
        self.hottest_c = -math.inf
        self._faults: Set[str] = frozenset()
        self._chamber_ms = 0

    def drive(self, pins: Pins, now_ms: int) -> None:
        """Put the board's pins on the relays."""
        if pins != self.pins:
            self._pass_to(now_ms)
            self.pins = pins
            self._switch(now_ms)

    def let_go(self, now_ms: int) -> None:
        """Release the pins of a stopped firmware: they float, and pull-downs hold them safe."""
        self.drive(self.reset_pins, now_ms)

    def set_faults(self, faults: Set[str], now_ms: int) -> None:
        """Names of the faults that last from now on."""
        self._pass_to(now_ms)
        self._faults = faults
        self._switch(now_ms)

    def sense(self, now_ms: int) -> Mapping[str, float]:
        """Return the sensors' present values."""
        self._pass_to(now_ms)
        self.hottest_c = max(self.hottest_c, self.chamber.truth()["temp_air_c"])
        sensed = self.chamber.sense()
        for signal in self._absent & sensed.keys():
            del sensed[signal]
        if self._has_tacho:
            sensed["fan_rpm"] = FAN_RPM if self.fan else 0.0
        return sensed

    def truth(self, now_ms: int) -> dict[str, float]:
        """Return the true state of the greenhouse now."""
        self._pass_to(now_ms)
        return self.chamber.truth()

    def _switch(self, now_ms: int) -> None:
        relay = self.pins.heater_relay or "heater_stuck_on" in self._faults
        self.heat = relay and not self.pins.cutoff_open and "heater_dead" not in self._faults
        self.fan = (self.pins.fan or "fan_stuck_on" in self._faults) and "fan_stuck_off" not in self._faults
        if not self.pins.heater_relay:
            self.heater_pin_on_at_ms = None
        elif self.heater_pin_on_at_ms is None:
            self.heater_pin_on_at_ms = now_ms

    def _pass_to(self, now_ms: int) -> None:
        dt_ms = now_ms - self._chamber_ms
        if dt_ms == 0:
            return
        self._chamber_ms = now_ms
        self.chamber.step(dt_ms / 1000, float(self.heat), self.fan, self.pins.led, self.pins.valve)
        if self.heat:
            self.heat_on_ms += dt_ms
        for pin in ACTUATOR_PINS:
            if getattr(self.pins, pin):
                self.last_on_ms[pin] = now_ms
