"""Weather around a box and the owner's control: rough, and unknown to the workflow."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from bench.foreign.box import BoxWeather, Control

Floats = NDArray[np.float64]
HOUR_S, DAY_S = 3600.0, 86_400.0
DRIVES = ("steps", "thermostat", "timer", "climb")


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
        self.on = temp_c < self.low_c or (self.on and temp_c < self.high_c)
        return float(self.on)


def draw_control(rng: Generator, kind: str, rows: int, step_s: float, tau_s: float, rise_k: float,
                 room_c: float, has_fan: bool) -> Control:  # fmt: skip
    """Draw steps, a thermostat with changing set points, a timer, or a ramp of levels up and down."""
    fan = _spells(rng, rows, step_s, (0.3 * tau_s, 3.0 * tau_s), lambda: float(rng.random() < 0.4))
    fan = fan if has_fan else np.zeros(rows)
    if kind == "thermostat":
        targets = _spells(
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
        duty = _spells(rng, rows, step_s, (0.5 * tau_s, 4.0 * tau_s), lambda: float(rng.random() < 0.5))
    else:
        duty = _spells(
            rng, rows, step_s, (0.5 * tau_s, 5.0 * tau_s), lambda: float(rng.choice([0, 0.25, 0.4, 0.6, 1]))
        )
    # Every log begins at rest, so that a twin can start from what the first rows show.
    duty[: max(3, rows // 60)] = 0.0
    return lambda row, _: (float(duty[row]), float(fan[row]))


def _spells(
    rng: Generator, rows: int, step_s: float, lasts_s: tuple[float, float], value: Callable[[], float]
) -> Floats:
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
    clouds = _spells(rng, rows, step_s, (0.2 * tau_s, 2.0 * tau_s), lambda: rng.choice([0.15, 0.6, 1.0]))
    return np.asarray(peak_w * np.clip(day, 0.0, 1.0) * clouds)


def visits_w(rng: Generator, rows: int, step_s: float, each_w: float, tau_s: float) -> Floats:
    """Draw the heat of people or pumps that come and go [W]."""
    return _spells(rng, rows, step_s, (0.7 * tau_s, 5.0 * tau_s), lambda: each_w * rng.choice([0, 0, 1, 2]))
