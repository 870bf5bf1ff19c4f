"""Reach of a box: how warm full power makes it in a still room without sun, and how soon."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bench.boxes.facts import BoxFacts
from bench.boxes.physics import BoxPhysics

Floats = NDArray[np.float64]
REFERENCE_SHARES = (
    0.15,
    0.80,
)  # of the rise, so that power is left to follow it
HOTTEST_C = 38.0  # 2 K below temp_air_max_c, at which the daemon ends all heating
QUICK, NEARLY = 1.0 - np.exp(-1.0), 0.95  # shares of the rise


@dataclass(frozen=True, slots=True)
class Still:
    """A room that stays as it is, without sun."""

    room_c: float

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return the room [°C], no sun, and nominal mains."""
        return self.room_c, 0.0, 1.0


@dataclass(frozen=True, slots=True)
class Reach:
    """Air of a box at rest in its mean room, and the way there at full power."""

    zero_c: float  # without heat
    full_c: float  # at full power
    fan_c: float  # at full power while the fan blows
    quick_s: float  # until 63 % of the rise
    slow_s: float  # until 95 %

    @property
    def rise_k(self) -> float:
        """By which full power warms the air."""
        return self.full_c - self.zero_c


@lru_cache(maxsize=64)
def reach(facts: BoxFacts) -> Reach:
    """Return the reach of a box in a still room at its mean temperature."""
    room_c = facts.room.mean_c
    physics = BoxPhysics(facts, Still(room_c))
    zero_c, fan_c = (
        float(physics.air_c(physics.rest(room_c, *inputs))[0]) for inputs in ((0.0, 0.0), (1.0, 1.0))
    )
    times, states = physics.warm_up(room_c, 1.0)
    air = physics.air_c(states)
    rise = air - air[0]
    quick_s, slow_s = (float(times[np.argmax(rise >= share * rise[-1])]) for share in (QUICK, NEARLY))
    return Reach(zero_c, float(air[-1]), fan_c, quick_s, slow_s)


def rise_k(facts: BoxFacts) -> float:
    """Return by how much full power without the fan warms the air over the room."""
    room_c = facts.room.mean_c
    physics = BoxPhysics(facts, Still(room_c))
    return float(physics.air_c(physics.rest(room_c, 1.0))[0] - room_c)


def rise_after_k(facts: BoxFacts, hours: float) -> float:
    """Return by how much full power without the fan warms the air within hours, from rest [K]."""
    physics = BoxPhysics(facts, Still(facts.room.mean_c))
    times, states = physics.warm_up(facts.room.mean_c, 1.0)
    air = physics.air_c(states)
    return float(np.interp(3600.0 * hours, times, air - air[0]))


def scaled_reference(reference_k01: Floats, facts: BoxFacts) -> Floats:
    """Return a course 0..1 [N] as a reference that this box can follow [°C].

    0 becomes 15 % of the box's rise over its mean room, and 1 becomes 80 %, but at most HOTTEST_C.
    """
    low, high = REFERENCE_SHARES
    high = min(high, (HOTTEST_C - facts.room.mean_c) / reach(facts).rise_k)
    share = low + (high - low) * np.asarray(reference_k01, dtype=np.float64)
    return np.asarray(facts.room.mean_c + share * reach(facts).rise_k)
