"""Inputs and surroundings of a run, as the independent simulator takes them, and random ones.

Drawn are steps of heater and fan as in the paper, and a room that wanders. `Bend` is the view and action of
an effect outside the library.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Floats = NDArray[np.float64]
REST_ROWS = 15  # off before the first recorded row, so that no command is under way
BEFORE_ROWS = 90  # simulated before it
MINUTE_S, DAY_S = 60.0, 86400.0


@dataclass(frozen=True, slots=True)
class ColumnInputs:
    """Inputs of B columns in N steps, each [N, B].

    duty, fan : commands; ambient : the room as its sensor would show it, without noise [°C], [N + 1, B]
    light 0..1, rel_humidity [%]; day : since the first run; hour : of the day; door : share of the step open
    power : factor of the mains; heat_w : into the air, from nowhere; chance : a wander of unit variance
    """

    duty: Floats
    fan: Floats
    ambient: Floats
    light: Floats
    rel_humidity: Floats
    day: Floats
    hour: Floats
    door: Floats
    power: Floats
    heat_w: Floats
    chance: Floats

    def columns(self, which: Sequence[int]) -> "ColumnInputs":
        """Return some of the columns, also the same one many times."""
        chosen = {name: getattr(self, name)[:, which] for name in self.__slots__}
        return ColumnInputs(**chosen)


@dataclass(frozen=True, slots=True)
class OutsideConditions:
    """Conditions that an outside effect may see, each [B]."""

    air: Floats
    room: Floats
    duty: Floats
    fan: Floats
    light: Floats
    rel_humidity: Floats
    hour: Floats
    day: Floats
    chance: Floats
    fan_hours: Floats  # how long the fan has run


@dataclass(frozen=True, slots=True)
class Bend:
    """The action of an effect outside the library; None: no action of that kind."""

    heat_w: Callable[[OutsideConditions], Floats] | None = None  # into the air
    power: Callable[[OutsideConditions], Floats] | None = None  # factor on the heater
    flow: Callable[[OutsideConditions], Floats] | None = None  # factor on the fan
    reading: Callable[[OutsideConditions], Floats] | None = None  # added to what the sensor shows


@dataclass(frozen=True, slots=True)
class DrawnSurroundings:
    """How the room and the light behave in all runs of a case.

    room_c : mean of all; wander_k, wander_min : sd and correlation time of the room within a run
    drift_k_day : of the room over the runs; day_span : days from the first run to the last
    """

    room_c: float
    wander_k: float
    wander_min: float
    slope_k_h: float
    day_span: int
    mains_sd: float
    heat_w: float
    heat_tau_min: float


def draw_surroundings(rng: Generator) -> DrawnSurroundings:
    """Draw the surroundings of one case."""
    return DrawnSurroundings(
        room_c=rng.uniform(19.0, 23.0),
        wander_k=rng.uniform(0.5, 0.9),
        wander_min=rng.uniform(60.0, 120.0),
        slope_k_h=rng.normal(0.0, 0.15),
        day_span=int(rng.integers(6, 20)),
        mains_sd=0.015,
        heat_w=rng.uniform(0.5, 1.5),
        heat_tau_min=rng.uniform(5.0, 15.0),
    )


def draw_inputs(
    rng: Generator, around: DrawnSurroundings, rows: Sequence[int]
) -> tuple[ColumnInputs, Floats]:
    """Draw inputs of runs of so many rows, one column each, and each run's
    begin [days since the first, hours].

    A column begins BEFORE_ROWS before its first row; those after its last are padding.
    Returns : inputs, and starts [2, B]: day since the first run's, hour of the day
    """
    count, steps = len(rows), BEFORE_ROWS + max(rows)
    later = 1.0 + rng.choice(max(around.day_span, count), count - 1, replace=False)  # one run a day
    days = np.sort(np.append(0.0, later))
    hours = rng.uniform(7.0, 17.0, count).round(2)
    columns = [_column(rng, around, steps, hour) for hour in hours]
    stacked = {name: np.stack([column[name] for column in columns], axis=1) for name in columns[0]}
    elapsed_h = (np.arange(steps)[:, None] - BEFORE_ROWS) / 60.0
    since_first = days + (hours - hours[0]) / 24.0
    return ColumnInputs(
        **stacked, hour=(hours + elapsed_h) % 24.0, day=since_first + elapsed_h / 24.0
    ), np.stack([days, hours])


def _column(rng: Generator, around: DrawnSurroundings, steps: int, hour: float) -> dict[str, Floats]:
    duty, fan = _commands(rng, steps)
    room = around.room_c + rng.normal(0.0, 0.8)
    hours = np.arange(steps + 1) / 60.0
    ambient = room + around.slope_k_h * hours
    ambient += around.wander_k * _smooth(wander(rng, steps + 1, around.wander_min), 5)
    return {
        "duty": duty,
        "fan": fan,
        "ambient": ambient,
        "light": _light(rng, steps),
        "rel_humidity": np.clip(rng.uniform(40.0, 60.0) + 9.0 * _smooth(wander(rng, steps, 45.0), 5), 15, 95),
        "door": _door(rng, steps),
        "power": np.full(steps, 1.0 + rng.normal(0.0, around.mains_sd)),
        "heat_w": around.heat_w * wander(rng, steps, around.heat_tau_min),
        "chance": wander(rng, steps, 15.0),
    }


def _commands(rng: Generator, steps: int) -> tuple[Floats, Floats]:
    """Duty on its grid of 0.05, and fan; off just before the first row, in half of the runs long before."""
    peak = rng.uniform(0.5, 1.0)
    fan_share = rng.uniform(0.15, 0.5)
    fan = hold(rng, steps, (2, 30), lambda: float(rng.random() < fan_share))
    if rng.random() < 0.3:
        duty = _regulate(rng, steps, fan, peak)
    else:
        longest = int(rng.choice([20, 40, 60]))
        duty = hold(rng, steps, (10, longest), lambda: _level(rng, peak))
    begin = 0 if rng.random() < 0.5 else BEFORE_ROWS - REST_ROWS
    duty[begin:BEFORE_ROWS] = fan[begin:BEFORE_ROWS] = 0.0
    return duty, fan


def _level(rng: Generator, peak: float) -> float:
    return 0.0 if rng.random() < 0.2 else float(np.round(20.0 * rng.uniform(0.05, peak)) / 20.0)


def _regulate(rng: Generator, steps: int, fan: Floats, peak: float) -> Floats:
    """Return the duty of a proportional controller on a crude box of one body."""
    wanted = hold(rng, steps, (30, 90), lambda: rng.uniform(3.0, 14.0))
    duty, excess = np.zeros(steps), 0.0
    for k in range(steps):
        duty[k] = np.round(20.0 * np.clip(0.15 * (wanted[k] - excess), 0.0, peak)) / 20.0
        excess += (100.0 * duty[k] - (5.0 + 14.0 * fan[k]) * excess) * MINUTE_S / 6000.0
    return duty


def _light(rng: Generator, steps: int) -> Floats:
    """Draw a dimmed lamp: off for a third of the time, at any level else."""
    return hold(
        rng, steps, (20, 80), lambda: 0.0 if rng.random() < 0.35 else round(float(rng.uniform(0.2, 1.0)), 2)
    )


def _door(rng: Generator, steps: int) -> Floats:
    """Share of each step that the door is open: half a minute to four, now and then."""
    opened = np.zeros(steps)
    at = BEFORE_ROWS + rng.exponential(60.0)
    while at < steps - 6:
        edges = np.clip(np.arange(steps + 1.0), at, at + rng.uniform(0.5, 4.0))
        opened += np.diff(edges)
        at += 8.0 + rng.exponential(60.0)
    return opened


def hold(rng: Generator, steps: int, minutes: tuple[int, int], value: Callable[[], float]) -> Floats:
    """Values that hold for a random number of steps each."""
    values = np.empty(steps)
    k = 0
    while k < steps:
        length = int(rng.integers(minutes[0], minutes[1] + 1))
        values[k : k + length] = value()
        k += length
    return values


def wander(rng: Generator, steps: int, tau_steps: float) -> Floats:
    """First-order autoregressive noise of unit variance."""
    decay = np.exp(-1.0 / tau_steps)
    kicks = np.sqrt(1.0 - decay**2) * rng.normal(size=steps)
    values = np.empty(steps)
    value = rng.normal()
    for k in range(steps):
        value = decay * value + kicks[k]
        values[k] = value
    return values


def _smooth(values: Floats, width: int) -> Floats:
    """Return the moving mean: a room has a mass of its own."""
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    return np.convolve(padded, np.ones(width) / width, "valid")
