"""Rollouts of a twin: the loop over linear steps, and `March` for those that one matrix per fan speed lacks.

Such steps have late commands, a fan that spins up or is on for a share of them, or heat that bends with the
temperature. A step is cut where a late command arrives, and each part is exact for inputs constant over it.
Where the fan spins up or stops a part has the fan's mean speed (Magnus expansion, first term), and heat that
depends on the air's temperature is taken at the middle of a part (exponential midpoint rule, Hochbruck &
Ostermann 2010, Acta Numerica 19): both of second order in parts of at most `PART_S` or `BENT_PART_S`.

Error at steps of 60 s, against SciPy at 1e-9 (test_twin_equations.py): rounding alone in linear
effects; below 0.01 K with one that is not, beside a lossy wall, and 0.02 K with two; 0.03 K where two zones
of air meet bent heat, whose bend is taken at the sensor's; 0.04 K for a fan that spins up in a lossless box.
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
PART_S = 5.0  # of a fan that spins up, or is on for a share of a step: its relay is on for multiples of 5 s
BENT_PART_S = 7.5  # of bent heat alone
SHORTEST_S = 1e-6  # of a part: nothing happens in less, and rounding makes such
SPEED_DIGITS = 5  # of a mean speed: so that a fan that has nearly arrived needs no matrix of its own


class Commands(NamedTuple):
    """Commands of N steps, [N] or [B, N]."""

    duty: Floats
    fan: Floats


class _Part(NamedTuple):
    """A part of every step, over N steps and B rollouts: x+ = matrix x + driven + gain r."""

    matrix: Floats  # [N, B, n, n]
    driven: Floats  # [N, B, n]
    gain: Floats  # [N, B, n], of further heat [K/s] into the air

    def then(self, later: "_Part") -> "_Part":
        """Both parts as one."""
        return _Part(
            later.matrix @ self.matrix,
            times(later.matrix, self.driven) + later.driven,
            times(later.matrix, self.gain) + later.gain,
        )


@dataclass(frozen=True, slots=True, eq=False)
class March:
    """N steps of B rollouts.

    room : [N, B] as measured [°C]; columns : [N, B] each
    """

    signals: Signals
    air_capacity_j_k: float
    carried: tuple[int, ...]  # states that an offset moves, the air last
    parts: tuple[_Part, ...]
    room: Floats
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
        relay: bool,
    ) -> "March":
        """All matrices at once; the arguments as in `edge.twin.model.Twin.march`.

        relay : the fan is on or off, so that a value between is a share of the step
        """
        # All steps at once: matrices are made for the modes that occur, not in the loop over the steps.
        shape = (commands.fan.shape[1], commands.fan.shape[0])
        room = _in_time(ambient, shape)
        steps = {name: _in_time(column, shape) for name, column in columns.items()}
        past = before if before and before.duty.shape[-1] else Commands(np.zeros(1), np.zeros(1))
        every = Commands(_with_past(past.duty, commands.duty), _with_past(past.fan, commands.fan))
        lengths, acting = act(signals, step_s, every, relay, BENT_PART_S if signals.bends else step_s)
        first = len(every.fan) - len(room)
        speeds, duties = acting.fan[first:], signals.duty(acting.duty[first:])
        added = _in_time(source, shape)
        others = [steps.get(name, np.zeros(shape)) for name in ("door_open", "day")]
        parts: list[_Part] = []
        for j, length in enumerate(lengths):
            transition, which = _transitions(system, [speeds[:, j], *others], float(length))
            seen = {**steps, "fan_on": speeds[:, j]}
            heat_w = signals.heat_w(np.zeros(shape), room, seen, by_temp=False)
            heated = added + heat_w / system.air_capacity_j_k
            inputs = np.stack([duties[:, j], signals.room(room), heated], axis=-1)
            gains = transition.drive[which]
            part = _Part(transition.state[which], times(gains, inputs), gains[..., 2])
            parts = [*parts, part] if signals.bends or not parts else [parts[0].then(part)]
        carried = tuple(sorted({0, system.states.index(AIR)}))
        return cls(signals, system.air_capacity_j_k, carried, tuple(parts), room, steps)

    def step(self, k: int, states: Floats) -> Floats:
        """Return the states [B, n] after step k."""
        air, columns = self.carried[-1], {name: column[k] for name, column in self.columns.items()}
        for part in self.parts:
            gain = part.gain[k]
            moved = times(part.matrix[k], states) + part.driven[k]
            if self.signals.bends:
                guess = moved[:, air] + gain[:, air] * self._bend_heat(states[:, air], k, columns)
                middle = 0.5 * (states[:, air] + guess)
                moved += gain * np.asarray(self._bend_heat(middle, k, columns))[:, None]
            states = moved
        return states

    def matrix(self, k: int) -> Floats:
        """Return the derivative of step k with respect to the states, [B, n, n], without bent heat."""
        whole: Floats = self.parts[0].matrix[k]
        for part in self.parts[1:]:
            whole = part.matrix[k] @ whole
        return whole

    def rollout(self, states: Floats, offset: Floats | None) -> Floats:
        """Return the sensor's reading after each step, [B, N]."""
        shown = np.empty(self.room.shape)
        for k in range(len(shown)):
            states = self.step(k, states)
            if offset is not None:
                states[:, self.carried] += offset[k]
            shown[k] = states[:, 0]
        return shown.T

    def _bend_heat(self, temp: Floats, k: int, columns: Conditions) -> Floats | float:
        """Heat that depends on the air's temperature, as a source [K/s], [B]."""
        return self.signals.heat_w(temp, self.room[k], columns, by_temp=True) / self.air_capacity_j_k


def rollout(table: Floats, index: Indices, states: Floats, driven: Floats) -> Floats:
    """Linear steps x+ = table[index] x + driven of B rollouts; return the first state after each, [N, B].

    table : [K, n, n]; index : [N, B]; states : [B, n], before the first step; driven : [N, B, n]
    """
    shown = np.empty(index.shape)
    if not len(index):
        return shown
    matrices, is_steady = table[index[0]], bool((index == index[0]).all())
    for k in range(len(index)):
        if not is_steady:
            np.take(table, index[k], axis=0, out=matrices)
        states = times(matrices, states)
        states += driven[k]
        shown[k] = states[:, 0]
    return shown


def _transitions(system: LinearSystem, modes: list[Floats], length_s: float) -> tuple[Transition, Indices]:
    """Matrices of the modes that occur, [N, B] each, and which of them belongs to each place [N, B]."""
    code = np.zeros(modes[0].size, dtype=np.intp)
    for mode in modes:
        values, index = np.unique(mode, return_inverse=True)
        code = code * len(values) + index.ravel()
    _, places, which = np.unique(code, return_index=True, return_inverse=True)
    distinct = np.stack([mode.ravel()[places] for mode in modes], axis=-1)
    return discretise_modes(system, distinct, length_s), which.reshape(modes[0].shape)


def times(matrices: Floats, vectors: Floats) -> Floats:
    """Each matrix times its vector, [..., n, m] and [..., m]."""
    product: Floats = (matrices @ vectors[..., None])[..., 0]
    return product


def act(
    signals: Signals, step_s: float, commands: Commands, relay: bool, longest_s: float
) -> tuple[Floats, Commands]:
    """Return the parts of each step [J] [s], and the duty and fan that act in them, [R, J, B] each.

    commands : [R, B]; before the first row as in the first
    relay : as in `March.of`
    """
    parted = relay and has_shares(commands.fan)
    lengths = cuts(signals, step_s, min(longest_s, PART_S) if parted else longest_s)
    middles = np.cumsum(lengths) - lengths / 2.0
    fan = late(commands.fan, signals.fan_dead_s, middles, step_s)
    if parted:
        begins = (middles - signals.fan_dead_s) % step_s - lengths / 2.0
        fan = fan_in_parts(fan, begins[:, None], lengths[:, None], step_s)
    fan = spun_up(fan, lengths, signals.fan_lag_s)
    return lengths, Commands(late(commands.duty, signals.heater_dead_s, middles, step_s), fan)


def has_shares(fan: Floats) -> bool:
    """Return True if the fan is on for a share of a step somewhere, neither off nor on throughout."""
    return bool(((fan > 0.0) & (fan < 1.0)).any())


def fan_in_parts(share: Floats, begin_s: Floats, length_s: Floats | float, step_s: float) -> Floats:
    """Return the share of each part for which the fan is on; it is on at the beginning of the step.

    share : of the step; begin_s, length_s : of the part, from the step's beginning
    """
    on = np.clip((share * step_s - begin_s) / length_s, 0.0, 1.0)
    # Rounded as a mean speed is: 5 s of 60 s is a share that floats do not hold. No -0, which sorts apart.
    return np.asarray(np.round(on, SPEED_DIGITS) + 0.0)


def cuts(signals: Signals, step_s: float, longest_s: float) -> Floats:
    """Lengths of a step's parts: cut where late commands arrive, and fine where a fan spins up [s]."""
    arrivals = (signals.heater_dead_s % step_s, signals.fan_dead_s % step_s)
    inside = {arrival for arrival in arrivals if SHORTEST_S < arrival < step_s - SHORTEST_S}
    edges = np.array([0.0, *sorted(inside), step_s])
    whole = np.diff(edges)
    counts = np.ceil(whole / (PART_S if signals.fan_lag_s > 0.0 else longest_s)).astype(int)
    return np.repeat(whole / counts, counts)


def _with_past(past: Floats, coming: Floats) -> Floats:
    """[P + N, B] of [P] or [B, P] and [B, N]."""
    rows = np.broadcast_to(past, (len(coming), past.shape[-1]))
    return np.concatenate([rows, coming], axis=1).T


def late(commands: Floats, dead_s: float, middles: Floats, step_s: float) -> Floats:
    """Return the inputs that act in each part of each row, [P + N, J, B];
    before the first row as in the first.
    """
    back = np.floor((middles - dead_s) / step_s).astype(int)
    rows = np.maximum(np.arange(len(commands))[:, None] + back, 0)
    found: Floats = commands[rows]
    return found


def spun_up(wanted: Floats, lengths: Floats, lag_s: float) -> Floats:
    """Mean speed in each part, [P + N, J, B], from rest at the first row's speed."""
    if lag_s == 0.0:
        return wanted
    left = np.exp(-lengths / lag_s)[:, None]
    # A part's end is an affine function of its step's beginning, so that only the steps need a loop.
    gone = np.zeros_like(wanted)  # what the parts before have added
    for j in range(1, len(lengths)):
        gone[:, j] = gone[:, j - 1] * left[j - 1] + wanted[:, j - 1] * (1.0 - left[j - 1])
    whole = gone[:, -1] * left[-1] + wanted[:, -1] * (1.0 - left[-1])
    kept = np.concatenate([np.ones((1, 1)), np.cumprod(left, axis=0)])
    first = np.empty_like(whole)
    now = wanted[0, 0]
    for k in range(len(wanted)):
        first[k] = now
        now = kept[-1] * now + whole[k]
    before = first[:, None] * kept[:-1] + gone
    mean = (1.0 - left) * lag_s / lengths[:, None]
    return np.asarray(np.round(wanted + (before - wanted) * mean, SPEED_DIGITS))


def _in_time(values: ArrayLike, shape: tuple[int, int]) -> Floats:
    """[N, B] of a scalar, [N] or [B, N]."""
    array = np.asarray(values, dtype=np.float64)
    return np.broadcast_to(array[:, None] if array.ndim == 1 else array.T, shape)
