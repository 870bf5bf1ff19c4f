"""Steps that one matrix per fan speed does not make: late commands, a fan that spins up, bent heat.

A step is cut where a late command arrives, and each part is exact for inputs constant over it. Where the fan
spins up a part has the fan's mean speed (Magnus expansion, first term), and heat that depends on the air's
temperature is taken at the middle of a part (exponential midpoint rule, Hochbruck & Ostermann 2010, Acta
Numerica 19): both of second order in parts of at most `PART_S`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edge.twin.discretisation import Transition, discretise_modes
from edge.twin.network import AIR, LinearSystem
from edge.twin.signals import Conditions, Signals

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
PART_S = 5.0


class Commands(NamedTuple):
    """Commands of N steps, [N] or [B, N]."""

    duty: Floats
    fan: Floats


class _Part(NamedTuple):
    """One part of every step, over N steps and B rollouts."""

    transition: Transition
    which: Indices  # [N, B]
    duty: Floats  # [N, B]


@dataclass(frozen=True, slots=True, eq=False)
class March:
    """N steps of B rollouts.

    room, source : [N, B]; columns : [N, B] each
    """

    signals: Signals
    air_capacity_j_k: float
    carried: tuple[int, ...]  # states that an offset moves
    parts: tuple[_Part, ...]
    room: Floats
    source: Floats
    columns: Conditions

    @classmethod
    def of(
        cls,
        system: LinearSystem,
        signals: Signals,
        step_s: float,
        commands: Commands,
        ambient: ArrayLike,
        source: ArrayLike,
        columns: Conditions,
        before: Commands | None,
    ) -> "March":
        """All matrices at once; the arguments as in `edge.twin.model.Twin.march`."""
        shape = (commands.fan.shape[1], commands.fan.shape[0])
        room, added = _in_time(ambient, shape), _in_time(source, shape)
        steps = {name: _in_time(column, shape) for name, column in columns.items()}
        past = before if before and before.duty.shape[-1] else Commands(np.zeros(1), np.zeros(1))
        duty = _with_past(past.duty, commands.duty)
        fan = _with_past(past.fan, commands.fan)
        lengths = _cuts(signals, step_s)
        begins = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
        middles = begins + lengths / 2.0
        speeds = _spun_up(_late(fan, signals.fan_dead_s, middles, step_s), lengths, signals.fan_lag_s)
        duties = _late(duty, signals.heater_dead_s, middles, step_s)
        others = [steps.get(name, np.zeros(shape)) for name in ("door_open", "day")]
        parts, first = [], len(fan) - shape[0]
        for j, length in enumerate(lengths):
            modes = np.stack([speeds[first:, j], *others], axis=-1).reshape(-1, 3)
            unique, index = np.unique(modes, axis=0, return_inverse=True)
            transition = discretise_modes(system, unique, float(length))
            parts.append(_Part(transition, index.reshape(shape), signals.duty(duties[first:, j])))
        carried = tuple(sorted({0, system.states.index(AIR)}))
        return cls(signals, system.air_capacity_j_k, carried, tuple(parts), room, added, steps)

    def step(self, k: int, states: Floats) -> Floats:
        """The states [B, n] after step k."""
        signals, room = self.signals, self.room[k]
        columns = {name: column[k] for name, column in self.columns.items()}
        shown = signals.room(room)
        fixed = self.source[k] + self._rate(states[:, 0], room, columns, by_temp=False)
        air = self.carried[-1]
        for part in self.parts:
            matrix, gains = part.transition.state[part.which[k]], part.transition.drive[part.which[k]]
            moved = np.einsum("bij,bj->bi", matrix, states)
            moved += gains[:, :, 0] * part.duty[k][:, None] + gains[:, :, 1] * shown[:, None]
            moved += gains[:, :, 2] * fixed[:, None]
            if signals.bends:
                first = self._rate(states[:, air], room, columns, by_temp=True)
                guess = moved[:, air] + gains[:, air, 2] * first
                middle = 0.5 * (states[:, air] + guess)
                moved += gains[:, :, 2] * self._rate(middle, room, columns, by_temp=True)[:, None]
            states = moved
        return states

    def matrix(self, k: int) -> Floats:
        """What step k makes of a small difference in the states, [B, n, n]; bent heat left out."""
        whole: Floats = self.parts[0].transition.state[self.parts[0].which[k]]
        for part in self.parts[1:]:
            whole = part.transition.state[part.which[k]] @ whole
        return whole

    def rollout(self, states: Floats, offset: Floats | None) -> Floats:
        """What the sensor shows after each step, [B, N]."""
        shown = np.empty(self.room.shape)
        for k in range(len(shown)):
            states = self.step(k, states)
            if offset is not None:
                states[:, self.carried] += offset[k]
            shown[k] = states[:, 0]
        return shown.T

    def _rate(self, temp: Floats, room: Floats, columns: Conditions, by_temp: bool) -> Floats:
        """Heat from elsewhere as a source [K/s], [B]."""
        return self.signals.heat_w(temp, room, columns, by_temp) / self.air_capacity_j_k


def _cuts(signals: Signals, step_s: float) -> Floats:
    """Lengths of a step's parts: cut where late commands arrive, and fine where that counts [s]."""
    arrivals = {signals.heater_dead_s % step_s, signals.fan_dead_s % step_s}
    edges = np.array(sorted({0.0, *arrivals, step_s}))
    whole = np.diff(edges)
    fine = signals.bends or signals.fan_lag_s > 0.0
    counts = np.ceil(whole / PART_S).astype(int) if fine else np.ones(len(whole), dtype=int)
    return np.repeat(whole / counts, counts)


def _with_past(past: Floats, coming: Floats) -> Floats:
    """[P + N, B] of [P] or [B, P] and [B, N]."""
    rows = np.broadcast_to(past, (len(coming), past.shape[-1]))
    return np.concatenate([rows, coming], axis=1).T


def _late(commands: Floats, dead_s: float, middles: Floats, step_s: float) -> Floats:
    """What acts in each part of each row, [P + N, J, B]; before the first row as in the first."""
    back = np.floor((middles - dead_s) / step_s).astype(int)
    rows = np.maximum(np.arange(len(commands))[:, None] + back, 0)
    found: Floats = commands[rows]
    return found


def _spun_up(wanted: Floats, lengths: Floats, lag_s: float) -> Floats:
    """Mean speed in each part, [P + N, J, B], from rest at the first row's speed."""
    if lag_s == 0.0:
        return wanted
    speeds, now = np.empty_like(wanted), wanted[0, 0]
    left = np.exp(-lengths / lag_s)
    mean = (1.0 - left) * lag_s / lengths
    for k in range(len(wanted)):
        for j in range(len(lengths)):
            off = now - wanted[k, j]
            speeds[k, j] = wanted[k, j] + off * mean[j]
            now = wanted[k, j] + off * left[j]
    return speeds


def _in_time(values: ArrayLike, shape: tuple[int, int]) -> Floats:
    """[N, B] of a scalar, [N] or [B, N]."""
    array = np.asarray(values, dtype=np.float64)
    return np.broadcast_to(array[:, None] if array.ndim == 1 else array.T, shape)
