"""Between the board's pins and the chamber: relays, dead times, heater supply, fan, and a meter on them."""

import copy
import math
from collections import deque
from collections.abc import Mapping, Set
from typing import Protocol

from firmware_protocol.messages import Capability
from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters, Number
from firmware_protocol.virtual_board.core import Pins
from firmware_protocol.virtual_board.effects import Effects
from firmware_protocol.virtual_board.noise import Wander, normal

_DAY_S = 86400.0


class DeadTime:
    """A value that arrives delay_s late."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._coming: deque[tuple[float, float]] = deque()
        self._last = self.value = 0.0

    def put(self, value: float, now_s: float) -> None:
        """Set the value that holds from now on."""
        if value != self._last:
            self._coming.append((now_s + self._delay_s, value))
            self._last = value
        self.arrive(now_s)

    def arrive(self, now_s: float) -> None:
        """Let through what is due."""
        while self._coming and self._coming[0][0] <= now_s:
            self.value = self._coming.popleft()[1]

    def next_change(self) -> float:
        """When the value changes next [s], infinite when nothing is under way."""
        return self._coming[0][0] if self._coming else math.inf

    def copy(self) -> "DeadTime":
        """Return an independent copy; values under way arrive in both."""
        twin = copy.copy(self)
        twin._coming = self._coming.copy()
        return twin


class SlidingMean:
    """Mean of a piecewise constant value over the last window_s (0: the value itself)."""

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._pieces: deque[tuple[float, float]] = deque()  # length [s], value
        self._length_s = 0.0

    def add(self, value: float, dt_s: float) -> float:
        """Return the mean after dt_s more of this value."""
        if self._window_s <= 0.0:
            return value
        self._pieces.append((dt_s, value))
        self._length_s += dt_s
        while self._length_s - self._pieces[0][0] >= self._window_s:
            self._length_s -= self._pieces.popleft()[0]
        total = sum(length * piece for length, piece in self._pieces)
        oldest_s, oldest = self._pieces[0]
        surplus_s = self._length_s - self._window_s
        if surplus_s > 0.0:
            return (total - min(surplus_s, oldest_s) * oldest) / self._window_s
        return total / self._length_s

    def copy(self) -> "SlidingMean":
        """Return an independent copy with the same window so far."""
        twin = copy.copy(self)
        twin._pieces = self._pieces.copy()
        return twin


class HeaterSupply:
    """Power that reaches the element."""

    def __init__(self, parameters: ChamberParameters, effects: Effects, seed: int) -> None:
        heater, mains = parameters.heater, parameters.mains
        run = effects.power_run_variation * mains.run_sd * normal(seed, 20, 0)
        self._power_w = heater.power_w * max(1.0 + run, 0.0)
        self._wander_sd = effects.power_wander * mains.wander_sd
        self._wander = Wander(seed, 21, mains.wander_tau_s)
        self._efficiency = max(1.0 - effects.heater_efficiency * (1.0 - heater.efficiency), 0.0)
        self._saturation = max(1.0 - effects.heater_saturation * (1.0 - heater.saturation_duty), 0.0)
        self._sag = effects.heater_sag * heater.sag
        self._thermostat_c = heater.thermostat_c
        self._derating = effects.heater_thermostat * heater.thermostat_share_per_k
        self._needs_duty = self._saturation < 1.0 or self._sag > 0.0
        self._duty = SlidingMean(heater.duty_window_s)

    def power_w(self, fraction: float, dt_s: float, now_s: float, element_c: float) -> float:
        """Heat in the element while the relay is closed for this fraction of dt_s [W]."""
        power = self._power_w * fraction * self._efficiency
        if self._wander_sd > 0.0:
            power *= 1.0 + self._wander_sd * self._wander.at(now_s)
        if self._needs_duty:
            power *= self._limit(self._duty.add(fraction, dt_s))
        if self._derating > 0.0 and element_c > self._thermostat_c:
            power *= max(1.0 - self._derating * (element_c - self._thermostat_c), 0.0)
        return max(power, 0.0)

    def _limit(self, duty: float) -> float:
        """Factor of saturation, min(u, u_sat)/u, and of sag, 1 - sag u."""
        cut = self._saturation / duty if duty > self._saturation else 1.0
        return cut * max(1.0 - self._sag * duty, 0.0)

    def copy(self) -> "HeaterSupply":
        """Return an independent copy with the same future wander and the same duty so far."""
        twin = copy.copy(self)
        twin._wander, twin._duty = copy.copy(self._wander), self._duty.copy()
        return twin


class Fan:
    """Speed and flow of the fan pair."""

    def __init__(self, parameters: ChamberParameters, effects: Effects) -> None:
        fan = parameters.fan
        self._spinup_s = effects.fan_spinup * fan.spinup_s
        self.full_flow_m3_s = (
            fan.flow_m3_s
            * max(1.0 - effects.fan_effectiveness * (1.0 - fan.effectiveness), 0.0)
            * max(1.0 - effects.short_circuit * fan.short_circuit, 0.0)
        )
        self._clogging_per_s = effects.fan_clogging * fan.clogging_per_day / _DAY_S
        self._run_s = 0.0
        self.speed = 0.0  # now, share of full
        self.mean_speed = 0.0  # over the last step
        self.flow_m3_s = 0.0  # air really exchanged, mean over the last step

    def spun_up(self, speed: Number, on: Number, dt_s: float) -> tuple[Number, Number]:
        """Speed after dt_s towards `on` (0 or 1), and its mean; exact for a first-order spin-up."""
        if self._spinup_s <= 0.0:
            return on, on
        part = self._spinup_s / dt_s * -math.expm1(-dt_s / self._spinup_s)
        return on + (speed - on) * math.exp(-dt_s / self._spinup_s), on + (speed - on) * part

    def step(self, dt_s: float, on: float) -> None:
        """Run towards on (0 or 1) for dt_s."""
        self.speed, self.mean_speed = self.spun_up(self.speed, on, dt_s)
        self._run_s += self.mean_speed * dt_s
        self.flow_m3_s = (
            self.full_flow_m3_s * self.mean_speed * max(1.0 - self._clogging_per_s * self._run_s, 0.0)
        )


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
    """The greenhouse: `chamber.Chamber`, as the plant and the control socket need it."""

    def step(self, dt_s: float, heater_power_fraction: float, fan: bool, led: float, valve: bool) -> None:
        """Let `dt_s` pass with these inputs [s, 0..1, relay, 0..1, valve open]."""
        ...

    def sense(self) -> dict[str, float]:
        """Return the sensors' present values under the names of `sensor_report`."""
        ...

    def truth(self) -> dict[str, float]:
        """Return the true state, `temp_air_c` in it; the board never sees this."""
        ...

    def energy(self) -> dict[str, float]:
        """Return the heat since the start [J]: in, out and stored, where in = out + stored."""
        ...


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
