"""Steps of a box through time, for many states at once."""

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bench.boxes.facts import BoxFacts
from bench.boxes.rates import ZERO_C, BoxRates, HeldInputs, saturated_g_m3

Floats = NDArray[np.float64]
Inputs = float | Floats  # one number for all states, or [M]
GAMMA = 1.0 - math.sqrt(0.5)  # lets ROS2 damp fast parts completely
STEP_SHARE = 0.35  # of the quicker air layer's time constant, that an inner step may last
STEPS_S = (0.25, 5.0)  # shortest and longest inner step
BLOCK = 200  # states at once: numpy's library would divide larger products among threads, and wait
LENGTHS_MAX = 300  # of steps whose inverses are in memory
LATE_S = 4e6  # then a box is at rest
WAY, LEAP = 1.05, 3.0  # growth of the steps towards rest, to see the way and to see its end


class Around(Protocol):
    """Surroundings of a box, a function of time alone."""

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return the room [°C], the sun on the window [W/m²] and the mains (1: nominal power)."""
        ...


class BoxPhysics:
    """A box that steps states [M, n]: temperatures [K], vapour [g/m³], sensor [K], heat in and out [J]."""

    def __init__(self, facts: BoxFacts, around: Around) -> None:
        self.facts, self.around = facts, around
        self._rates = BoxRates(facts)
        self.size = self._rates.size
        self._jacobians = self._linearise()
        fastest = -np.diag(self._jacobians[0])[:2].min()
        self._inner_s = float(np.clip(STEP_SHARE / fastest, *STEPS_S))
        self._inverses: dict[float, tuple[Floats, Floats]] = {}

    def start(self, count: int, time_s: float = 0.0) -> Floats:
        """Return `count` states at rest in the room, [count, n]."""
        states = np.full((count, self.size), ZERO_C + self.around.at(time_s)[0])
        states[:, self._rates.vapour] = 1e3 * self.facts.room.vapour_kg_m3
        states[:, [self._rates.heat_in, self._rates.heat_out]] = 0.0
        return states

    def step(self, states: Floats, time_s: float, dt_s: float, heater_on: Inputs, fan_on: Inputs) -> Floats:
        """Return the states [M, n] dt_s after time_s.

        heater_on : share of the power; fan_on : share of the step that the fan blows; both 0..1
        """
        heater, fan = np.asarray(heater_on, dtype=np.float64), np.asarray(fan_on, dtype=np.float64)
        if len(states) > BLOCK:
            parts = range(0, len(states), BLOCK)
            wide = np.broadcast_to(heater, len(states)), np.broadcast_to(fan, len(states))
            return np.concatenate(
                [
                    self.step(states[k : k + BLOCK], time_s, dt_s, *(row[k : k + BLOCK] for row in wide))
                    for k in parts
                ]
            )
        x = np.ascontiguousarray(states.T)
        count = max(1, math.ceil(dt_s / self._inner_s - 1e-9))
        h = dt_s / count
        inverses = self._inverse(h)[: 2 if fan.any() else 1]
        for k in range(count):
            held = self._rates.hold(len(states), self.around.at(time_s + (k + 0.5) * h), heater, fan)
            x = self._ros2(x, h, held, fan, inverses)
        return x.T

    def air_c(self, states: Floats) -> Floats:
        """Return the mean of the air [M]."""
        return np.asarray(0.5 * (states[:, 0] + states[:, 1]) - ZERO_C)

    def reading_c(self, states: Floats) -> Floats:
        """Return what the sensor of the air shows before noise and steps, with its bias [M]."""
        return self._rates.felt_k(states.T) - ZERO_C + self.facts.air.bias_k

    def humidity_pct(self, states: Floats) -> Floats:
        """Return the relative humidity of the air [M]."""
        saturated = saturated_g_m3(0.5 * (states[:, 0] + states[:, 1]))
        return np.minimum(100.0 * states[:, self._rates.vapour] / saturated, 100.0)

    def node_c(self, states: Floats, name: str) -> Floats:
        """Return the temperature of a node by its name in `nodes`, e.g. wall_0 [M]."""
        return np.asarray(states[:, self._rates.nodes.index[name]] - ZERO_C)

    def heat_j(self, states: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the heat that came in and went out since the start, and that is stored over 0 K [M]."""
        rates = self._rates
        return states[:, rates.heat_in], states[:, rates.heat_out], states @ rates.capacity

    def rest(self, room_c: float, heater: float, fan: float = 0.0) -> Floats:
        """Return the state [1, n] in which a box rests in a still room without sun."""
        return self.warm_up(room_c, heater, fan, LEAP)[1][-1:]

    def warm_up(
        self, room_c: float, heater: float, fan: float = 0.0, growth: float = WAY
    ) -> tuple[Floats, Floats]:
        """Return times [N] and states [N, n] on the way to rest in a still room without sun.

        Steps grow, so N is some hundred. Each solves the equations linearised at its beginning.
        """
        rates, around = self._rates, (room_c, 0.0, 1.0)
        held = rates.hold(1, around, np.asarray(heater), np.asarray(fan))
        x = np.full((self.size, 1), ZERO_C + room_c)
        x[rates.vapour] = 1e3 * self.facts.room.vapour_kg_m3
        x[[rates.heat_in, rates.heat_out]] = 0.0
        times, found, h = [0.0], [x[:, 0]], 1.0
        one = np.eye(self.size)
        while times[-1] < LATE_S:
            slope = rates.rates(x, held)
            x = x + h * np.linalg.solve(one - h * self._jacobian(x, around, heater, fan), slope)
            times.append(times[-1] + h)
            found.append(x[:, 0])
            h *= growth
        return np.array(times), np.array(found)

    def _jacobian(self, x: Floats, around: tuple[float, float, float], heater: float, fan: float) -> Floats:
        """Return the slopes of the rates [n, n] at a state [n, 1], by differences."""
        by = 1e-3
        columns = np.concatenate((x, x + by * np.eye(self.size)), axis=1)
        held = self._rates.hold(columns.shape[1], around, np.asarray(heater), np.asarray(fan))
        rates = self._rates.rates(columns, held)
        return np.asarray((rates[:, 1:] - rates[:, :1]) / by)

    def _linearise(self) -> tuple[Floats, Floats]:
        """Slopes without and with the fan, in a warm box."""
        room_c = self.facts.room.mean_c
        warm = self.rest(room_c, 0.7).T
        still, blown = (self._jacobian(warm, (room_c, 0.0, 1.0), 0.7, fan) for fan in (0.0, 1.0))
        return still, blown

    def _inverse(self, h: float) -> tuple[Floats, Floats]:
        """Inverses of 1 - gamma h J: without the fan, and what the fan adds to it."""
        if h not in self._inverses:
            if len(self._inverses) >= LENGTHS_MAX:
                self._inverses.clear()
            one = np.eye(self.size)
            still, blown = (np.asarray(np.linalg.inv(one - GAMMA * h * it)) for it in self._jacobians)
            self._inverses[h] = still, blown - still
        return self._inverses[h]

    def _ros2(
        self, x: Floats, h: float, held: HeldInputs, fan: Floats, inverses: tuple[Floats, ...]
    ) -> Floats:
        """One step of ROS2, Verwer et al., SIAM J. Sci. Comput. 20 (1999) 1456.

        The order is 2 with any matrix in place of the Jacobian. So one matrix is inverted once, without and
        with the fan, and a fan that blows part of the step takes a blend of both inverses.
        """

        def solve(slope: Floats) -> Floats:
            solved = inverses[0] @ slope
            for added in inverses[1:]:
                solved += fan * (added @ slope)
            return np.asarray(solved)

        first = solve(self._rates.rates(x, held))
        slope = self._rates.rates(x + h * first, held)
        slope -= 2.0 * first
        first *= 1.5
        first += 0.5 * solve(slope)
        first *= h
        first += x
        return first
