"""A drawn box behind the pins of a virtual board: `Plant(Box(facts, seed), box.parts())`."""

import math

import numpy as np

from bench.boxes.facts import BoxFacts, OtherSensor
from bench.boxes.physics import BoxPhysics
from firmware_protocol.messages import Capability

DAY_S = 86_400.0
CLOUD_S, MAINS_S = 600.0, 900.0  # between two knots of a random walk
KNOTS = 4096  # then a walk starts again: after 28 days of clouds
NIGHT_S = (22.5 * 3600.0, 6.0 * 3600.0)  # begin and end of the setback
SETBACK_LAG_S = 3600.0
DRIFT_S = (2.3 * DAY_S, 3.9 * DAY_S, 6.1 * DAY_S)  # periods that never come together


class Knots:
    """Random numbers -1..1 in time, with straight lines between."""

    def __init__(self, seed: int, stream: int, period_s: float) -> None:
        values = np.random.default_rng([seed, stream]).uniform(-1.0, 1.0, KNOTS)
        self._values, self._period_s = values.tolist(), period_s

    def at(self, time_s: float) -> float:
        """Return the value at a time."""
        place = time_s / self._period_s
        before = math.floor(place)
        first, second = self._values[before % KNOTS], self._values[(before + 1) % KNOTS]
        return float(first + (place - before) * (second - first))


class BoxDisturbances:
    """Disturbances of a box; the same seed gives the same ones."""

    def __init__(self, facts: BoxFacts, seed: int) -> None:
        self._room, self._has_sun = facts.room, facts.room.sun_peak_w_m2 > 0.0
        self._clouds, self._mains = Knots(seed, 1, CLOUD_S), Knots(seed, 2, MAINS_S)
        self._phases = np.random.default_rng([seed, 3]).uniform(0.0, 2.0 * math.pi, 5).tolist()
        self._last: tuple[float, tuple[float, float, float]] = (math.nan, (0.0, 0.0, 0.0))

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return the room [°C], the sun on the window [W/m²] and the mains (1: nominal power)."""
        if time_s != self._last[0]:
            mains = 1.0 + self._room.mains_share * self._mains.at(time_s)
            self._last = time_s, (self.room_c(time_s), self.sun_w_m2(time_s), mains)
        return self._last[1]

    def room_c(self, time_s: float) -> float:
        """Return the temperature of the room."""
        room, phases = self._room, self._phases
        day = (room.start_s + time_s) % DAY_S
        temp = room.mean_c + room.daily_k * math.sin(2.0 * math.pi * (day / DAY_S - 0.4))
        for period_s, phase in zip(DRIFT_S, phases, strict=False):
            temp += room.drift_k / len(DRIFT_S) * math.sin(2.0 * math.pi * time_s / period_s + phase)
        if room.hvac_k:
            temp += room.hvac_k * (_cycle(time_s / room.hvac_period_s + phases[3]) - 0.5)
        return temp - room.setback_k * _night(day)

    def sun_w_m2(self, time_s: float) -> float:
        """Return the sun on the window, with clouds."""
        if not self._has_sun:
            return 0.0
        room = self._room
        height = ((room.start_s + time_s) % DAY_S - room.sunrise_s) / (room.sunset_s - room.sunrise_s)
        if not 0.0 < height < 1.0:
            return 0.0
        cover = min(max(0.5 + 0.9 * self._clouds.at(time_s), 0.0), 1.0)
        return room.sun_peak_w_m2 * math.sin(math.pi * height) * (1.0 - 0.85 * cover)


def _cycle(place: float) -> float:
    """Share 0..1 of a thermostat's swing: up within 40 % of the period, then down, both exponentially."""
    place %= 1.0
    if place < 0.4:
        return (1.0 - math.exp(-2.0 * place / 0.4)) / (1.0 - math.exp(-2.0))
    return (math.exp(-2.0 * (place - 0.4) / 0.6) - math.exp(-2.0)) / (1.0 - math.exp(-2.0))


def _night(day_s: float) -> float:
    """Share 0..1 of the setback that the room has followed by a time of day."""
    begin_s, end_s = NIGHT_S
    length_s = (end_s - begin_s) % DAY_S
    since_s = (day_s - begin_s) % DAY_S
    if since_s < length_s:
        return 1.0 - math.exp(-since_s / SETBACK_LAG_S)
    full = 1.0 - math.exp(-length_s / SETBACK_LAG_S)
    return full * math.exp(-(since_s - length_s) / SETBACK_LAG_S)


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
