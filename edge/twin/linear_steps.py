"""A twin as one linear step per row of recorded runs, also where its effects are late, slow or bent.

Where temperatures were measured, heat that bends with the air's temperature has a tangent there, so that
every twin is x+ = A x + d with a matrix and a drive of its own for each row. What an input, a start or an
unknown heat does to the temperature is then linear, exactly, and many twins can be run at once
(`edge.twin.ensemble`).

Error against `Twin.rollout`: rounding for linear effects; for bent ones of second order in the distance from
what was measured: 0.01 K where noise is 0.3 K, 0.06 K where it is 1 K, 0.03 K in a hole of two rows and 0.3 K
in one of ten while the heater is switched (tests/test_linear_steps.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.errors import DataError
from edge.twin.discretisation import exponential
from edge.twin.march import cuts, late, spun_up, times
from edge.twin.model import DAY_S, Twin
from edge.twin.network import AIR
from edge.twin.recorded import Recorded
from edge.twin.signals import Conditions, columns_of
from edge.twin.warm_start import held

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
SLOPE_LEVELS = 8  # of bent heat, between its flattest and steepest: one matrix for each
SLOPE_K = 0.05  # either side of where a slope is taken
AGES_PER_DAY = 48.0  # walls age in half hours: one matrix for each


@dataclass(frozen=True, slots=True, eq=False)
class LinearSteps:
    """x+ = table[index] x + driven, over N rows of B runs; the first state is what the sensor shows.

    table : [K, n, n]; index : [N, B]; driven : [N, B, n], by all inputs
    duty : [N, B, n], the heater's part of `driven`
    room, heat : [N, B, n], by 1 K of the room, and by 1 W into the air
    """

    states: tuple[str, ...]
    table: Floats
    index: Indices
    driven: Floats
    duty: Floats
    room: Floats
    heat: Floats


class _Bend(NamedTuple):
    """Heat that bends with the air's temperature, by its tangent: Q = level + slope T, [N, B] each."""

    slope_w_k: Floats
    level_w: Floats


class _Part(NamedTuple):
    """One part of every row: its modes (fan, door, day, slope), and what it does for each mode that occurs.

    state : [K, n, n]; drive : [K, n, 3]; which : [N, B]; duty : [N, B]; heat_w : [N, B]
    """

    state: Floats
    drive: Floats
    which: Indices
    duty: Floats
    heat_w: Floats


def linear_steps(twin: Twin, runs: Recorded) -> LinearSteps:
    """The rows of `runs` by `twin`. Errors: DataError naming a column that is missing, or `day0_utc`."""
    parts = _parts(twin, runs)
    table, index = _folded_matrices(parts)
    shape = (*parts[0].which.shape, len(twin.states))
    duty, room, heat, driven = (np.zeros(shape) for _ in range(4))
    room_c = twin.signals.room(runs.ambient.T)[..., None]
    for part in parts:
        matrix = part.state[part.which] if len(parts) > 1 else None
        by_input = part.drive[part.which]
        by_duty = by_input[..., 0] * part.duty[..., None]
        by_watt = by_input[..., 2] / twin.system.air_capacity_j_k
        duty = _then(matrix, duty) + by_duty
        room = _then(matrix, room) + by_input[..., 1]
        heat = _then(matrix, heat) + by_watt
        all_inputs = by_duty + by_input[..., 1] * room_c + by_watt * part.heat_w[..., None]
        driven = _then(matrix, driven) + all_inputs
    return LinearSteps(twin.states, table, index, driven, duty, room, heat)


def _then(matrix: Floats | None, vectors: Floats) -> Floats:
    return vectors if matrix is None else times(matrix, vectors)


def _parts(twin: Twin, runs: Recorded) -> list[_Part]:
    signals, shape = twin.signals, runs.fan.T.shape
    room, columns = runs.ambient.T, _columns(twin, runs)
    lengths = cuts(signals, twin.step_s, twin.step_s)
    middles = np.cumsum(lengths) - lengths / 2.0
    before = np.zeros((1, shape[1]))  # nothing is known of the time before: both off
    fan, duty = np.concatenate([before, runs.fan.T]), np.concatenate([before, runs.duty.T])
    speeds = spun_up(late(fan, signals.fan_dead_s, middles, twin.step_s), lengths, signals.fan_lag_s)[1:]
    duties = signals.duty(late(duty, signals.heater_dead_s, middles, twin.step_s)[1:])
    bend = _bend(twin, runs, columns)
    door, day = (columns.get(name, np.zeros(shape)) for name in ("door_open", "day"))
    parts = []
    for j, length in enumerate(lengths):
        modes = [speeds[:, j], door, day, bend.slope_w_k]
        state, drive, which = _transitions(twin, modes, float(length))
        seen = {**columns, "fan_on": speeds[:, j]}
        heat_w = bend.level_w + signals.heat_w(np.zeros(shape), room, seen, by_temp=False)
        parts.append(_Part(state, drive, which, duties[:, j], heat_w))
    return parts


def _columns(twin: Twin, runs: Recorded) -> dict[str, Floats]:
    """Columns that the twin's heat depends on, [N, B] each, with `day` where walls age."""
    columns = {name: column.T for name, column in columns_of(twin.needs, runs.conditions).items()}
    if twin.signals.ageing_per_day != 0.0:
        if twin.day0_utc is None:
            raise DataError("day0_utc: missing, the twin's ua_drift counts days from it")
        days = np.round((columns["utc"] - twin.day0_utc) / DAY_S * AGES_PER_DAY) / AGES_PER_DAY
        columns["day"] = twin.signals.days(days)
    return columns


def _bend(twin: Twin, runs: Recorded, columns: Conditions) -> _Bend:
    """The tangent where the air was measured: in the middle of each row, held over holes."""
    shape = runs.fan.T.shape
    if not twin.signals.bends:
        return _Bend(np.zeros(shape), np.zeros(shape))
    temps = np.stack([held(row) for row in runs.temp])
    middle = (0.5 * (temps[:, 1:] + temps[:, :-1])).T

    def heat_w(temp: Floats) -> Floats:
        return np.asarray(twin.signals.heat_w(temp, runs.ambient.T, columns, by_temp=True))

    slope = (heat_w(middle + SLOPE_K) - heat_w(middle - SLOPE_K)) / (2.0 * SLOPE_K)
    slope = _levelled(slope)
    return _Bend(slope, heat_w(middle) - slope * middle)


def _levelled(slopes: Floats) -> Floats:
    """To one of a few values, in shares of the range, so that a fitted value moves them smoothly."""
    low, high = float(slopes.min()), float(slopes.max())
    if high - low <= 1e-12:
        return slopes
    step = (high - low) / SLOPE_LEVELS
    return low + step * np.round((slopes - low) / step)


def _transitions(twin: Twin, modes: list[Floats], length_s: float) -> tuple[Floats, Floats, Indices]:
    """Matrices [K, n, n] and drives [K, n, 3] of the modes that occur, and which belongs to each place."""
    code, which = _coded(modes)
    fan, door, day, slope = (mode.ravel()[code][:, None, None] for mode in modes)
    system = twin.system
    bent = np.zeros((len(twin.states), len(twin.states)))
    bent[:, system.states.index(AIR)] = system.drive[:, 2] / system.air_capacity_j_k
    rates = system.rates + fan * system.fan_rates + slope * bent
    rates = rates + door * system.other_rates[0] + day * system.other_rates[1]
    drive = system.drive + fan * system.fan_drive
    drive = drive + door * system.other_drive[0] + day * system.other_drive[1]
    state, integral = exponential(rates, length_s)
    return state, integral @ drive, which


def _coded(modes: Sequence[Floats | Indices]) -> tuple[Indices, Indices]:
    """A place where each combination of modes occurs, and which combination holds at each place."""
    varying = [np.ascontiguousarray(mode) for mode in modes if not (mode == mode.flat[0]).all()]
    places, which = _combinations(tuple((mode.tobytes(), mode.dtype.char) for mode in varying))
    return places, which.reshape(modes[0].shape) if varying else np.zeros(modes[0].shape, dtype=np.intp)


@lru_cache(maxsize=64)  # twins of one search see the same fan: sorting it is what takes the time
def _combinations(columns: tuple[tuple[bytes, str], ...]) -> tuple[Indices, Indices]:
    """Of columns as bytes, so that they can be remembered; flat."""
    code = np.zeros(1, dtype=np.intp)
    for content, kind in columns:
        values, index = np.unique(np.frombuffer(content, dtype=kind), return_inverse=True)
        code = np.unique(code * len(values) + index, return_inverse=True)[1]
    _, places, which = np.unique(code, return_index=True, return_inverse=True)
    return places, which


def _folded_matrices(parts: list[_Part]) -> tuple[Floats, Indices]:
    """One matrix for each sequence of parts that occurs, and which belongs to each row."""
    if len(parts) == 1:
        return parts[0].state, parts[0].which
    places, index = _coded([part.which for part in parts])
    table: Floats = np.eye(parts[0].state.shape[-1])
    for part in parts:
        table = part.state[part.which.ravel()[places]] @ table
    return table, index
