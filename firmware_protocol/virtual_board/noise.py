"""Repeatable noise without a stored generator: a value is a function of seed, stream and index.

So a copy of the chamber has the same future, and the noise does not depend on the length of a step.
"""

import math

_MASK = 0xFFFFFFFFFFFFFFFF


def _mix(x: int) -> int:
    """Finaliser of splitmix64 (Steele, Lea, Flood 2014); 64 bits in, 64 bits out."""
    x = (x + 0x9E3779B97F4A7C15) & _MASK
    x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & _MASK
    return x ^ (x >> 31)


def uniform(seed: int, stream: int, index: int) -> float:
    """Return a number in (0, 1), the same for the same arguments."""
    return (_mix(_mix(_mix(seed & _MASK) ^ stream) ^ (index & _MASK)) + 0.5) / 2.0**64


def normal(seed: int, stream: int, index: int) -> float:
    """Return a standard normal number, the same for the same arguments (Box and Muller)."""
    radius = math.sqrt(-2.0 * math.log(uniform(seed, stream, 2 * index)))
    return radius * math.cos(2.0 * math.pi * uniform(seed, stream, 2 * index + 1))


class Wander:
    """First-order autoregressive noise of unit variance on a fixed grid, straight lines between.

    tau_s : correlation time [s];  grid_s : distance of the grid's points [s]
    """

    __slots__ = ("_after", "_before", "_decay", "_grid_s", "_index", "_kick", "_seed", "_stream")

    def __init__(self, seed: int, stream: int, tau_s: float, grid_s: float = 10.0) -> None:
        self._seed, self._stream, self._grid_s = seed, stream, grid_s
        self._decay = math.exp(-grid_s / tau_s)
        self._kick = math.sqrt(1.0 - self._decay**2)
        self._index = 0
        self._before = normal(seed, stream, 0)
        self._after = self._next(self._before, 1)

    def _next(self, value: float, index: int) -> float:
        return self._decay * value + self._kick * normal(self._seed, self._stream, index)

    def at(self, time_s: float) -> float:
        """Value at time_s, which may not go back beyond the last grid point passed."""
        while time_s >= (self._index + 1) * self._grid_s:
            self._index += 1
            self._before, self._after = self._after, self._next(self._after, self._index + 1)
        return self._before + (self._after - self._before) * (time_s / self._grid_s - self._index)
