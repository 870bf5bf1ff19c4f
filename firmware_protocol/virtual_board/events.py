"""Events in the box that nobody commands: door openings."""

import math

from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters
from firmware_protocol.virtual_board.effects import Effects
from firmware_protocol.virtual_board.noise import uniform


class DoorSchedule:
    """Openings at random times, of random length."""

    def __init__(self, parameters: ChamberParameters, effects: Effects, seed: int) -> None:
        self._p, self._seed, self._count = parameters.events, seed, 0
        self._w_k = effects.door_opening * parameters.events.door_w_k
        self._opens_s = self._closes_s = 0.0
        self._next(0.0)

    def _next(self, now_s: float) -> None:
        p = self._p
        wait, length = (uniform(self._seed, stream, self._count) for stream in (30, 31))
        self._count += 1
        self._opens_s = now_s - p.door_interval_s * math.log(wait)
        self._closes_s = self._opens_s + p.door_shortest_s + (p.door_longest_s - p.door_shortest_s) * length

    def conductance(self, now_s: float) -> float:
        """Exchange with the room through the door now [W/K]."""
        if self._w_k <= 0.0:
            return 0.0
        while now_s >= self._closes_s:
            self._next(self._closes_s)
        return self._w_k if now_s >= self._opens_s else 0.0

    def next_change(self, now_s: float) -> float:
        """When the door moves next [s]."""
        if self._w_k <= 0.0:
            return math.inf
        return self._opens_s if now_s < self._opens_s else self._closes_s
