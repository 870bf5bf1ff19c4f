"""A drawn box behind the pins of a virtual board: `Plant(Box(facts, seed), box.parts())`."""

import math

import numpy as np

from bench.boxes.disturbances import BoxDisturbances
from bench.boxes.facts import BoxFacts, OtherSensor
from bench.boxes.physics import BoxPhysics
from firmware_protocol.messages import Capability

NOISES = 1 << 15  # numbers in the table of noise
SPREAD = 2_654_435_761  # Knuth's multiplicative hash, so that near times have far noises
AIR, ROOM, HUMIDITY = range(3)  # streams of noise


class Box:
    """One state of a box; it satisfies `ChamberModel` of the virtual board.

    seed : of weather, mains and noise. The noise is a function of time, so a second look shows the same.
    """

    def __init__(self, facts: BoxFacts, seed: int) -> None:
        self.facts = facts
        self.physics = BoxPhysics(facts, BoxDisturbances(facts, seed))
        self.time_s = 0.0
        self.state = self.physics.start(1)  # [1, n]
        self._noise = np.random.default_rng([seed, 4]).standard_normal(NOISES)
        self._stored_j = float(self.physics.heat_j(self.state)[2][0])

    def parts(self) -> Capability:
        """Return the optional parts of a board in this box."""
        parts = Capability(0)
        if self.facts.room_sensor is not None:
            parts |= Capability.TEMP_AMBIENT
        if self.facts.humidity_sensor is not None:
            parts |= Capability.HUMIDITY
        return parts

    def step(self, dt_s: float, heater_power_fraction: float, fan: bool, led: float, valve: bool) -> None:
        """Let dt_s pass. A box has neither LED nor valve: led and valve change nothing."""
        self.state = self.physics.step(self.state, self.time_s, dt_s, heater_power_fraction, float(fan))
        self.time_s += dt_s

    def sense(self) -> dict[str, float]:
        """Return the sensors' present values under the names of `sensor_report`."""
        air, shown = self.facts.air, float(self.physics.reading_c(self.state)[0])
        sensed = {"temp_air_c": _round(shown + air.noise_sd_k * self._random(AIR), air.step_k)}
        if (room := self.facts.room_sensor) is not None:
            sensed["temp_ambient_c"] = self._show(self._room_c(), room, ROOM)
        if (damp := self.facts.humidity_sensor) is not None:
            percent = float(self.physics.humidity_pct(self.state)[0])
            sensed["rel_humidity_pct"] = min(max(self._show(percent, damp, HUMIDITY), 0.0), 100.0)
        return sensed

    def truth(self) -> dict[str, float]:
        """Return the true state; `temp_sensor_c` is without bias, noise and steps."""
        physics, state = self.physics, self.state
        return {
            "temp_air_c": float(physics.air_c(state)[0]),
            "temp_sensor_c": float(physics.reading_c(state)[0]) - self.facts.air.bias_k,
            "temp_ambient_c": self._room_c(),
            "temp_wall_c": float(physics.node_c(state, "wall_0")[0]),
            "temp_floor_c": float(physics.node_c(state, "floor_0")[0]),
            "rel_humidity_pct": float(physics.humidity_pct(state)[0]),
        }

    def energy(self) -> dict[str, float]:
        """Return the heat since the start [J]: in, out and stored, where in = out + stored."""
        came, left, stored = (float(heat[0]) for heat in self.physics.heat_j(self.state))
        return {"in": came, "out": left, "stored": stored - self._stored_j}

    def _room_c(self) -> float:
        return self.physics.around.at(self.time_s)[0]

    def _show(self, value: float, sensor: OtherSensor, stream: int) -> float:
        return _round(value + sensor.bias + sensor.noise_sd * self._random(stream), sensor.step)

    def _random(self, stream: int) -> float:
        place = (round(1000.0 * self.time_s) * 3 + stream) * SPREAD
        return float(self._noise[(place >> 9) % NOISES])


def _round(value: float, step: float) -> float:
    return step * math.floor(value / step + 0.5)
