"""Lots of fifteen boxes: every quality comes in a lot as often as in any other lot, in another order.

So the development boxes and the scored ones show the same variety, and no box is in both.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bench.boxes.facts import MATERIALS, FanKind, HeaterKind

LOT = 15
POWERS_W = (20.0, 400.0)
RISES_K = (9.0, 42.0)  # of the air over the room at full power without fan
VOLUMES_M3 = (0.02, 1.0)
FILMS_M2_K_W = 0.2  # of both sides of a wall, roughly
MAT_W_M2 = 250.0  # of soil; more would cook the roots
CONSTRUCTIONS = (  # kind, layers of the wall, has soil; five light ones, five in between, five heavy ones
    ("film tent", (("polyethylene film", 0.0002),), False),
    ("twin-wall 4 mm", (("twin-wall", 0.004),), False),
    ("acrylic 3 mm", (("acrylic", 0.003),), False),
    ("EPS box 25 mm", (("EPS", 0.025),), False),
    ("film tent, soil", (("polyethylene film", 0.0002),), True),
    ("twin-wall 8 mm", (("twin-wall", 0.008),), True),
    ("polycarb. 4 mm", (("polycarbonate", 0.004),), True),
    ("twin-wall 10 mm", (("twin-wall", 0.010),), True),
    ("glass 3 mm", (("glass", 0.003),), False),
    ("plywood 9 mm", (("plywood", 0.009),), True),
    ("glass 5 mm", (("glass", 0.005),), True),
    ("plywood 18 mm", (("plywood", 0.018),), True),
    ("XPS 30 mm", (("XPS", 0.030),), True),
    ("plywood, EPS 30", (("plywood", 0.006), ("EPS", 0.030), ("plywood", 0.006)), True),
    ("plywood, XPS 50", (("plywood", 0.009), ("XPS", 0.050), ("plywood", 0.009)), True),
)
CLEAR = ("polyethylene film", "polycarbonate", "acrylic", "twin-wall", "glass")
HEATERS: tuple[HeaterKind, ...] = (
    "wire", "wire", "wire", "ptc", "ptc", "ptc", "ptc", "ceramic", "ceramic", "ceramic", "ceramic",
    "tube", "tube", "mat", "mat",
)  # fmt: skip
FANS: tuple[FanKind, ...] = ("exchange",) * 8 + ("stir",) * 4 + ("none",) * 3
ROOM_SENSORS = (True,) * 12 + (False,) * 3
HUMIDITY_SENSORS = (True,) * 10 + (False,) * 5
SUNS = (True,) * 9 + (False,) * 6
HVACS = (True,) * 8 + (False,) * 7
STEPS_K = (0.01, 0.01, 0.0625, 0.0625, 0.0625, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.25, 0.25, 0.5, 0.5)
LIGHT, MIDDLE = 5, 10  # constructions before these are light, or in between


@dataclass(frozen=True, slots=True)
class Lot:
    """Qualities of fifteen boxes, one of each list a box."""

    constructions: tuple[int, ...]  # of CONSTRUCTIONS
    volumes_m3: tuple[float, ...]
    heaters: tuple[HeaterKind, ...]


@lru_cache
def deal_lot(number: int) -> Lot:
    """Deal constructions, sizes and heaters until each box could be built."""
    rng = np.random.default_rng([number, 1])
    low, high = np.log(VOLUMES_M3)
    while True:
        builds = rng.permutation(LOT)
        volumes = np.exp(low + (high - low) * (rng.permutation(LOT) + rng.uniform(size=LOT)) / LOT)
        heaters = [HEATERS[k] for k in rng.permutation(LOT)]
        if all(map(_is_buildable, builds, volumes, heaters)):
            return Lot(tuple(builds.tolist()), tuple(volumes.tolist()), tuple(heaters))


def _is_buildable(build: int, volume_m3: float, heater: HeaterKind) -> bool:
    """Say whether a heater of POWERS_W suits the box, roughly; a mat lies under soil."""
    _, layers, has_soil = CONSTRUCTIONS[build]
    resistance = FILMS_M2_K_W + sum(
        thickness_m / MATERIALS[name].conductivity_w_m_k for name, thickness_m in layers
    )
    loss_w_k = 6.0 * volume_m3 ** (2.0 / 3.0) / resistance
    power_w = loss_w_k * RISES_K[0], loss_w_k * RISES_K[1]
    if heater == "mat" and not (has_soil and power_w[0] < MAT_W_M2 * volume_m3 ** (2.0 / 3.0)):
        return False
    return bool(power_w[0] < POWERS_W[1] and power_w[1] > POWERS_W[0])


class Hand:
    """Draws for one box: its place in its lot first, then its own random numbers."""

    def __init__(self, seed: int) -> None:
        half, number = divmod(seed - 1, 100)
        self.lot, self.place = 1000 * half + number // LOT, number % LOT
        self.rng = np.random.default_rng([seed, 2])

    def rank(self, quality: str) -> int:
        """Return the rank 0..14 of this box in a quality; a lot has each rank once."""
        salt = int.from_bytes(quality.encode()[:6], "big")
        return int(np.random.default_rng([self.lot, salt]).permutation(LOT)[self.place])

    def fifteenth(self, quality: str, low: float, high: float) -> float:
        """Draw evenly in this box's fifteenth of a range."""
        return low + (high - low) * (self.rank(quality) + self.rng.uniform()) / LOT

    def even(self, low: float = 0.0, high: float = 1.0) -> float:
        """Draw evenly."""
        return float(self.rng.uniform(low, high))

    def log(self, low: float, high: float) -> float:
        """Draw evenly in the logarithm."""
        return math.exp(self.even(math.log(low), math.log(high)))
