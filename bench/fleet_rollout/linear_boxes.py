"""Boxes of the generator, linearised about a warm state and stepped side by side: a fleet in seconds.

A box of `bench.boxes` keeps all its nodes, its walls, floor, contents, leaks and sensor; films, radiation and
evaporation are tangents at the state in which it rests at half power. The fan stays off.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from bench.boxes.draw import Still
from bench.boxes.facts import BoxFacts
from bench.boxes.physics import BoxPhysics
from bench.boxes.rates import BoxRates

Floats = NDArray[np.float64]
STEP_S = 60.0
WARM = 0.5  # share of the power at which a box is linearised
SLOWEST = 0.9999  # root of a step of a minute: a week
BY = 1e-3  # differences of states [K], of room [K] and heater [1]


@dataclass(frozen=True, slots=True, eq=False)
class LinearBox:
    """x+ = matrix x + inputs u, reading = felt x + shown, of deviations x [n] from the warm state.

    inputs : [n, 3] by the heater's share of its power, the room [K] and the sun [W/m²], from u0 [3]
    """

    matrix: Floats
    inputs: Floats
    u0: Floats
    felt: Floats
    shown: float

    def is_stable(self) -> bool:
        """Return whether the linearised box comes to rest: a tangent of air that stirs itself may not."""
        known = np.isfinite(self.matrix).all()
        return bool(known and np.abs(np.linalg.eigvals(self.matrix)).max() < SLOWEST)

    def gains_k(self) -> Floats:
        """Return the rise of the reading in the end by full power, 1 K of the room and 1 W/m² of sun [3]."""
        return np.asarray(self.felt @ np.linalg.solve(np.eye(len(self.matrix)) - self.matrix, self.inputs))

    def duty_at(self, reading_c: float) -> float:
        """Return the share of full power that holds a reading in the mean room, without sun."""
        return float(self.u0[0] + (reading_c - self.shown) / self.gains_k()[0])


def linear_box(facts: BoxFacts) -> LinearBox:
    """Linearise a box."""
    room_c = facts.room.mean_c
    warm = BoxPhysics(facts, Still(room_c)).rest(room_c, WARM).T
    rates = BoxRates(facts)
    # Counters of heat take no part, nor does a sensor that shows the air at once.
    size = rates.heat_in if facts.air.lag_s else rates.sensor
    columns = np.concatenate((warm, warm + BY * np.eye(len(warm))[:, :size]), axis=1)

    def slopes(x: Floats, room: float, sun: float, heater: float) -> Floats:
        held = rates.hold(x.shape[1], (room, sun, 1.0), np.asarray(heater), np.asarray(0.0))
        return np.asarray(rates.rates(x, held)[:size])

    by_state = slopes(columns, room_c, 0.0, WARM)
    f0 = by_state[:, :1]
    jacobian = (by_state[:, 1:] - f0) / BY
    by_input = np.concatenate(
        [
            (slopes(warm, room_c, 0.0, WARM + BY) - f0) / BY,
            (slopes(warm, room_c + BY, 0.0, WARM) - f0) / BY,
            slopes(warm, room_c, 1.0, WARM) - f0,
        ],
        axis=1,
    )
    whole = np.zeros((size + 3, size + 3))
    whole[:size] = np.concatenate((jacobian, by_input), axis=1)
    after = expm(STEP_S * whole)[:size]
    felt = rates.felt_k(columns)
    return LinearBox(
        after[:, :size],
        after[:, size:],
        np.array([WARM, room_c, 0.0]),
        (felt[1:] - felt[0]) / BY,
        float(felt[0]) - 273.15 + facts.air.bias_k,
    )


class LinearFleet:
    """Boxes side by side, each with a state of its own; it begins at rest without heat.

    boxes : B of them; readings are without noise and steps
    """

    def __init__(self, boxes: Sequence[LinearBox], room_c: Floats) -> None:
        size = max(len(box.matrix) for box in boxes)
        count = len(boxes)
        self._matrix = np.zeros((count, size, size))
        self._inputs, self._felt = np.zeros((count, size, 3)), np.zeros((count, size))
        self._u0 = np.array([box.u0 for box in boxes])
        self._shown = np.array([box.shown for box in boxes])
        self._state = np.zeros((count, size))
        for k, box in enumerate(boxes):
            n = len(box.matrix)
            self._matrix[k, :n, :n], self._inputs[k, :n], self._felt[k, :n] = box.matrix, box.inputs, box.felt
            cold = box.inputs @ (np.array([0.0, room_c[k], 0.0]) - box.u0)
            self._state[k, :n] = np.linalg.solve(np.eye(n) - box.matrix, cold)

    def readings(self) -> Floats:
        """Return what the sensors of the air show [B]."""
        return np.asarray(np.einsum("bn,bn->b", self._felt, self._state) + self._shown)

    def step(self, inputs: Floats) -> None:
        """Let a step pass. inputs : share of the power, room [°C] and sun [W/m²] of each box [B, 3]"""
        driven = np.einsum("bnk,bk->bn", self._inputs, inputs - self._u0)
        self._state = np.matmul(self._matrix, self._state[:, :, None])[:, :, 0] + driven
