"""Heated boxes of half a litre to a cubic metre, stepped in short explicit steps, and weather around them.

Differs from the engine on purpose: bodies exchange heat by their temperatures (the element too, which the
engine only delays), the loss is two films in series whose outer one depends on the temperature, the fan's
flow carries the density of the air that leaves. Several boxes may be stepped at once, one column each.
Weather and the owner's control are rough, and unknown to the workflow.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Floats = NDArray[np.float64]
AIR_J_KG_K = 1006.4
PRESSURE_PA, AIR_J_KG = 98_700.0, 287.05  # of a place 220 m above the sea
HOT_ELEMENT_K = 180.0  # above the air at full power
QUICKEST_SHARE = 0.05  # of the shortest time constant, that a step may last
FASTEST_S = 0.05
Control = Callable[[int, float], tuple[float, float]]  # row and reading to duty and fan
HOUR_S, DAY_S = 3600.0, 86_400.0
DRIVES = ("steps", "thermostat", "timer", "climb")


@dataclass(frozen=True, slots=True)
class ForeignBox:
    """Numbers, or one a box [P]; 0 where a part is not there.

    store, wall : bodies, the wall between two halves of its resistance
    curve : share by which the loss grows over 20 K; limit, sag : of the supply; share : of the fan's flow
    """

    volume_m3: float | Floats
    power_w: float | Floats
    loss_w_k: float | Floats
    contents_j_k: float | Floats
    flow_m3_s: float = 0.0
    curve: float = 0.0
    element_s: float = 0.0
    dead_s: float = 0.0
    sensor_s: float = 0.0
    store_j_k: float = 0.0
    store_w_k: float = 0.0
    wall_j_k: float = 0.0
    leak_m3_s: float = 0.0
    share: float = 1.0
    fan_w: float = 0.0
    limit: float = 1.0
    sag: float = 0.0
    mixing_w_k: float = 0.0
    base_w: float = 0.0
    free_w_k: float = 0.0
    room_error_k: float = 0.0
    cutout_c: float = np.inf
    cutout_gap_k: float = 0.0
    second_w: float = 0.0
    second_c: float = 0.0
    melts_j: float = 0.0
    melts_c: float = 0.0
    melts_over_k: float = 1.0
    lid_w_k: float = 0.0

    def less(self, hidden: dict[str, float]) -> "ForeignBox":
        """Without what some numbers of it do."""
        usual: dict[str, Any] = {item.name: item.default for item in fields(self)}
        return replace(self, **{name: usual[name] for name in hidden})

    def quickest_s(self) -> float:
        """Shortest time constant."""
        air = float(np.min(air_kg_m3(40.0) * self.volume_m3 * AIR_J_KG_K + self.contents_j_k))
        through = self.loss_w_k + self.store_w_k + self.free_w_k + self.mixing_w_k
        through = through + 1.2 * AIR_J_KG_K * (self.flow_m3_s * self.share + self.leak_m3_s)
        through = through + (self.power_w / HOT_ELEMENT_K if self.element_s else 0.0)
        if self.mixing_w_k:
            air *= 0.5
        times = [air / float(np.max(through))]
        times += [t for t in (self.element_s, self.sensor_s) if t]
        if self.wall_j_k:
            times.append(self.wall_j_k / float(np.max(4.0 * self.loss_w_k)))
        return min(times)


@dataclass(frozen=True, slots=True)
class BoxWeather:
    """Weather of a box, one number a row: the room, heat of others, open share of the lid, the mains."""

    room_c: Floats
    heat_w: Floats
    lid: Floats
    mains: Floats


def air_kg_m3(temp_c: float | Floats) -> float | Floats:
    """Dry air's density."""
    return PRESSURE_PA / (AIR_J_KG * (273.15 + temp_c))


def drive(
    box: ForeignBox, weather: BoxWeather, control: Control, step_s: float
) -> tuple[Floats, Floats, Floats]:
    """From rest in its room. Returns: what the sensor shows without noise [rows, P], duty and fan [rows]"""
    rows = len(weather.room_c)
    # Explicit steps, short against the quickest part: another way to solve it than the twin's own.
    parts = max(1, int(np.ceil(step_s / max(QUICKEST_SHARE * box.quickest_s(), FASTEST_S))))
    dt = step_s / parts
    shape = np.broadcast(*(np.atleast_1d(getattr(box, item.name)) for item in fields(box))).shape
    room = np.full(shape, weather.room_c[0])
    air, far, store, wall, sensor = (room.copy() for _ in range(5))
    element, cut, second = air.copy(), np.zeros(shape, bool), np.zeros(shape, bool)
    late = round(box.dead_s / dt)
    queue = [np.zeros(shape)] * late
    shown, duties, fans = np.empty((rows, *shape)), np.empty(rows), np.empty(rows)
    near = 0.5 if box.mixing_w_k else 1.0
    for k in range(rows):
        shown[k] = sensor if box.sensor_s else (far if box.mixing_w_k else air)
        duty, fan = control(k, float(shown[k].flat[0]))
        duties[k], fans[k] = duty, fan
        room_c = weather.room_c[k]
        supply = box.power_w * min(duty, box.limit) * (1.0 - box.sag * duty) * weather.mains[k]
        steady = weather.heat_w[k] + box.base_w + box.fan_w * fan
        lid = box.lid_w_k * weather.lid[k]
        blown = AIR_J_KG_K * (box.flow_m3_s * box.share * fan + box.leak_m3_s * (1.0 - fan))
        for _ in range(parts):
            cut = (air > box.cutout_c) | (cut & (air > box.cutout_c - box.cutout_gap_k))
            second = (air < box.second_c) | (second & (air < box.second_c + 1.0))
            queue.append(np.where(cut, 0.0, supply))
            power = queue.pop(0) + box.second_w * second
            if box.element_s:
                to_air = box.power_w / HOT_ELEMENT_K * (element - air)
                element = element + dt * (power - to_air) / (box.element_s * box.power_w / HOT_ELEMENT_K)
                power = to_air
            over = far - room_c if box.mixing_w_k else air - room_c
            through = box.loss_w_k * (1.0 + box.curve * np.abs(over) / 20.0)
            if box.wall_j_k:
                inward = 2.0 * through * ((far if box.mixing_w_k else air) - wall)
                wall = wall + dt * (inward - 2.0 * through * (wall - room_c)) / box.wall_j_k
            else:
                inward = through * over
            gone = inward + (lid + blown * air_kg_m3(room_c + over)) * over
            if box.free_w_k:
                gone = gone + box.free_w_k * np.sqrt(np.abs(over) / 10.0) * over
            capacity = air_kg_m3(air) * box.volume_m3 * AIR_J_KG_K + box.contents_j_k
            if box.melts_j:
                away = (air - box.melts_c) / box.melts_over_k
                capacity = capacity + box.melts_j / box.melts_over_k * np.exp(-(away**2)) / np.sqrt(np.pi)
            stored = box.store_w_k * (air - store) if box.store_j_k else 0.0
            if box.store_j_k:
                store = store + dt * stored / box.store_j_k
            if box.mixing_w_k:
                across = box.mixing_w_k * (air - far)
                air, far = (
                    air + dt * (power - across - stored) / (near * capacity),
                    far + dt * (across + steady - gone) / (near * capacity),
                )
            else:
                air = air + dt * (power + steady - gone - stored) / capacity
            if box.sensor_s:
                sensor = sensor + dt * ((far if box.mixing_w_k else air) - sensor) / box.sensor_s
    return shown, duties, fans


def draw_weather(rng: Generator, rows: int, step_s: float, power_w: float, usual_c: float) -> BoxWeather:
    """Draw a room with a day, airing and a radiator; a heat that walks; a mains that steps."""
    time_s = step_s * np.arange(rows, dtype=np.float64) + rng.uniform(0.0, DAY_S)
    room = usual_c + rng.uniform(-1.5, 1.5) + rng.uniform(0.2, 2.5) * np.sin(2.0 * np.pi * time_s / DAY_S)
    room = room + _sawtooth(time_s, rng.uniform(0.1, 0.8), rng.uniform(900.0, 5400.0))
    for at in np.flatnonzero(rng.random(rows) < step_s / (8.0 * HOUR_S)):
        room[at:] -= rng.uniform(0.5, 3.0) * np.exp(-(time_s[at:] - time_s[at]) / 1200.0)
    share = rng.uniform(0.001, 0.006)  # of the power, in a day's walk
    walk = np.cumsum(rng.standard_t(4.0, rows)) * share * power_w * np.sqrt(step_s / DAY_S)
    mains = np.ones(rows)
    for at in np.flatnonzero(rng.random(rows) < step_s / (3.0 * HOUR_S)):
        mains[at:] = 1.0 + rng.uniform(-0.02, 0.02)
    return BoxWeather(room, walk, np.zeros(rows), mains)


def _sawtooth(time_s: Floats, size_k: float, period_s: float) -> Floats:
    return size_k * ((time_s / period_s) % 1.0 - 0.5)


@dataclass(slots=True)
class Hysteresis:
    """Full on below, off above."""

    low_c: float
    high_c: float
    on: bool = False

    def __call__(self, temp_c: float) -> float:
        """Return 1.0 while heating: below `low_c`, then on until `high_c` (hysteresis)."""
        self.on = temp_c < self.low_c or (self.on and temp_c < self.high_c)
        return float(self.on)


def draw_control(rng: Generator, kind: str, rows: int, step_s: float, tau_s: float, rise_k: float,
                 room_c: float, has_fan: bool) -> Control:  # fmt: skip
    """Draw steps, a thermostat with changing set points, a timer, or a ramp of levels up and down."""
    fan = spells(rng, rows, step_s, (0.3 * tau_s, 3.0 * tau_s), lambda: float(rng.random() < 0.4))
    fan = fan if has_fan else np.zeros(rows)
    if kind == "thermostat":
        targets = spells(
            rng, rows, step_s, (3.0 * tau_s, 9.0 * tau_s), lambda: room_c + rise_k * rng.uniform(0.2, 0.75)
        )
        switch = Hysteresis(0.0, 0.0)
        band = max(0.25, 0.03 * rise_k)

        def regulate(row: int, temp_c: float) -> tuple[float, float]:
            switch.low_c, switch.high_c = targets[row] - band, targets[row] + band
            return switch(temp_c), fan[row]

        return regulate
    if kind == "climb":
        levels = np.abs((np.arange(rows) * step_s / (14.0 * tau_s)) % 2.0 - 1.0)
        duty = np.round(5.0 * levels) / 5.0
    elif kind == "timer":
        duty = spells(rng, rows, step_s, (0.5 * tau_s, 4.0 * tau_s), lambda: float(rng.random() < 0.5))
    else:
        duty = spells(
            rng, rows, step_s, (0.5 * tau_s, 5.0 * tau_s), lambda: float(rng.choice([0, 0.25, 0.4, 0.6, 1]))
        )
    # Every log begins at rest, so that a twin can start from what the first rows show.
    duty[: max(3, rows // 60)] = 0.0
    return lambda row, _: (float(duty[row]), float(fan[row]))


def spells(
    rng: Generator, rows: int, step_s: float, lasts_s: tuple[float, float], value: Callable[[], float]
) -> Floats:
    """Draw values that hold for a while each."""
    found = np.empty(rows)
    at = 0
    while at < rows:
        lasts = max(3, round(rng.uniform(*lasts_s) / step_s))
        found[at : at + lasts] = value()
        at += lasts
    return found


def sun_w(rng: Generator, rows: int, step_s: float, peak_w: float, tau_s: float) -> Floats:
    """Through a window, between clouds; a day lasts some time constants, so that a log shows several."""
    day = 2.0 * np.sin(2.0 * np.pi * np.arange(rows) * step_s / (12.0 * tau_s) + rng.uniform(0.0, 6.0))
    clouds = spells(rng, rows, step_s, (0.2 * tau_s, 2.0 * tau_s), lambda: rng.choice([0.15, 0.6, 1.0]))
    return np.asarray(peak_w * np.clip(day, 0.0, 1.0) * clouds)


def visits_w(rng: Generator, rows: int, step_s: float, each_w: float, tau_s: float) -> Floats:
    """Draw the heat of people or pumps that come and go [W]."""
    return spells(rng, rows, step_s, (0.7 * tau_s, 5.0 * tau_s), lambda: each_w * rng.choice([0, 0, 1, 2]))
