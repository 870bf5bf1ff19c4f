"""Inputs of the independent simulator, and the view and action of an effect outside the library."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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
