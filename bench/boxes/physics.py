"""Steps of a box through time, for many states at once."""

import math
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bench.boxes.facts import BoxFacts
from bench.boxes.rates import ZERO_C, BoxRates, HeldInputs, Modes, product, saturated_g_m3

Floats = NDArray[np.float64]
Inputs = float | Floats  # one number for all states, or [M]
LONGEST_S = 5.0  # inner step
ERROR_K = 0.012  # of the air or its sensor, after jumps of heater and fan
TRIAL = ((1.0, 0.0), (1.0, 1.0), (0.0, 0.0), (0.0, 1.0))  # heater and fan, one after the other
TRIAL_S, TRIAL_PARTS = 60.0, 10
LENGTHS_MAX = 300  # of steps whose matrices are in memory
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
        self._steps: dict[float, tuple[Floats, Floats, Floats]] = {}

    def start(self, count: int, time_s: float = 0.0) -> Floats:
        """Return `count` states at rest in the room, [count, n]."""
        return np.repeat(self._cold(self.around.at(time_s)[0]).T, count, axis=0)

    def step(self, states: Floats, time_s: float, dt_s: float, heater_on: Inputs, fan_on: Inputs) -> Floats:
        """Return the states [M, n] dt_s after time_s.

        heater_on : share of the power; fan_on : share of the step that the fan blows; both 0..1
        """
        heater, fan = _shares("heater_on", heater_on), _shares("fan_on", fan_on)
        x = np.ascontiguousarray(states.T)
        if fan.ndim == 0:
            return self._move(x, time_s, dt_s, heater, fan).T
        # One group a way of the fan: off, on, a part of the step.
        heater, after = np.broadcast_to(heater, fan.shape), np.empty_like(x)
        for group in (fan == 0.0, fan == 1.0, (fan > 0.0) & (fan < 1.0)):
            if group.all():
                return self._move(x, time_s, dt_s, heater, fan).T
            if group.any():
                after[:, group] = self._move(x[:, group], time_s, dt_s, heater[group], fan[group])
        return after.T

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
        x = self._cold(room_c)
        times, found, h = [0.0], [x[:, 0]], 1.0
        one = np.eye(self.size)
        while times[-1] < LATE_S:
            slope = rates.rates(x, held)
            x = x + h * np.linalg.solve(one - h * self._jacobian(x, around, heater, fan), slope)
            times.append(times[-1] + h)
            found.append(x[:, 0])
            h *= growth
        return np.array(times), np.array(found)

    def _cold(self, room_c: float) -> Floats:
        """State at rest in the room [n, 1]."""
        x = np.full((self.size, 1), ZERO_C + room_c)
        x[self._rates.vapour] = 1e3 * self.facts.room.vapour_kg_m3
        x[[self._rates.heat_in, self._rates.heat_out]] = 0.0
        return x

    def _jacobian(self, x: Floats, around: tuple[float, float, float], heater: float, fan: float) -> Floats:
        """Return the slopes of the rates [n, n] at a state [n, 1], by differences."""
        by = 1e-3
        columns = np.concatenate((x, x + by * np.eye(self.size)), axis=1)
        held = self._rates.hold(columns.shape[1], around, np.asarray(heater), np.asarray(fan))
        rates = self._rates.rates(columns, held)
        return np.asarray((rates[:, 1:] - rates[:, :1]) / by)

    @cached_property
    def _modes(self) -> tuple[Modes, Modes]:
        """Modes of a warm box without and with the fan; who only asks for rest needs none."""
        room_c = self.facts.room.mean_c
        warm = self.rest(room_c, 0.7).T
        still, blown = (Modes(self._jacobian(warm, (room_c, 0.0, 1.0), 0.7, fan)) for fan in (0.0, 1.0))
        return still, blown

    def _move(self, x: Floats, time_s: float, dt_s: float, heater: Floats, fan: Floats) -> Floats:
        """Step states [n, M] whose fans are all off, all on, or all on for a part."""
        count = max(1, math.ceil(dt_s / self._inner_s - 1e-9))
        h = dt_s / count
        for k in range(count):
            held = self._rates.hold(x.shape[1], self.around.at(time_s + (k + 0.5) * h), heater, fan)
            x = self._advance(x, h, held, fan)
        return x

    @cached_property
    def _inner_s(self) -> float:
        """Longest inner step: of LONGEST_S the part that keeps the error of a trial at ERROR_K.

        The order is 2, so the error falls with the square of the step. In the trial heater and fan jump.
        """
        room_c = self.facts.room.mean_c
        begin = np.concatenate((self._cold(room_c), self.rest(room_c, 1.0).T), axis=1)
        rough, fine = (self._trial(begin, LONGEST_S / parts) for parts in (1, TRIAL_PARTS))
        error_k = float(np.abs(rough - fine[TRIAL_PARTS - 1 :: TRIAL_PARTS]).max())
        return LONGEST_S / max(1, math.ceil(math.sqrt(error_k / ERROR_K)))

    def _trial(self, x: Floats, h: float) -> Floats:
        """Return both layers of air and the sensor after each inner step of a trial [N, 3, M]."""
        way = []
        for heater, fan in TRIAL:
            inputs = np.asarray(heater), np.asarray(fan)
            held = self._rates.hold(x.shape[1], (self.facts.room.mean_c, 0.0, 1.0), *inputs)
            for _ in range(round(TRIAL_S / h)):
                x = self._advance(x, h, held, inputs[1])
                way.append(np.stack((x[0], x[1], self._rates.felt_k(x))))
        return np.array(way)

    def _ways(self, h: float, fan: Floats) -> tuple[Floats, ...]:
        """Matrices [3 n, n] of a step by the fan: off, on, or what off has and what on adds."""
        if h not in self._steps:
            if len(self._steps) >= LENGTHS_MAX:
                self._steps.clear()
            still, blown = (modes.matrices(h) for modes in self._modes)
            self._steps[h] = still, blown, blown - still
        still, blown, added = self._steps[h]
        first = float(fan.flat[0])
        return (still,) if first == 0.0 else (blown,) if first == 1.0 else (still, added)

    def _advance(self, x: Floats, h: float, held: HeldInputs, fan: Floats) -> Floats:
        """One step of ETD2RK, Cox and Matthews, J. Comput. Phys. 176 (2002) 430.

        The slopes of a warm box are solved exactly, however stiff, and the rest with order 2. A fan that
        blows part of the step takes a blend of the matrices, which keeps the order.
        """
        n, ways = self.size, self._ways(h, fan)

        def spread(rows: slice, slope: Floats) -> Floats:
            moved = product(ways[0][rows], slope)
            for added in ways[1:]:
                moved += fan * product(added[rows], slope)
            return moved

        first = spread(slice(0, 2 * n), self._rates.rates(x, held))
        first[:n] += x
        first[n:] += x
        ahead = self._rates.rates(first[:n], held)
        first[n:] += spread(slice(2 * n, 3 * n), ahead)
        return first[n:]


def _shares(name: str, value: Inputs) -> Floats:
    shares = np.asarray(value, dtype=np.float64)
    if not (shares.min() >= 0.0 and shares.max() <= 1.0):  # NaN too
        raise ValueError(f"bench.boxes: {name} is {value}; shares are 0..1")
    return shares
