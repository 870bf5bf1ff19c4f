"""Linearisation of a twin: one linear step per row of recorded runs, also of late, slow or bent effects.

Where temperatures were measured, heat that bends with the air's temperature has a tangent there, so that
every twin is x+ = A x + d with a matrix and a drive of its own for each row. What an input, a start or an
unknown heat does to the temperature is then linear, exactly, and `responses` runs many twins at once.

Error against `BoxTwin.rollout`: rounding for linear effects; for bent ones of second order in the distance
from what was measured: 0.01 K where noise is 0.3 K, 0.06 K where it is 1 K, 0.03 K in a hole of two rows and
0.3 K in one of ten while the heater is switched (tests/edge/twin/test_linearise.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.twin.discretisation import distinct, exponentials
from edge.twin.effects.library import day_counter
from edge.twin.model import DAY_S, BoxTwin
from edge.twin.network import AIR
from edge.twin.rollout import Commands, act, rollout
from edge.twin.run_batch import RunBatch
from edge.twin.signals import Conditions, columns_of
from edge.twin.warm_start import hold

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


class _PartInputs(NamedTuple):
    """The inputs that act in each of J parts of every row.

    lengths : [J] [s]; fan, duty, heat_w : [N, J, B]; door, day, slope : [N, B]
    """

    lengths: Floats
    fan: Floats
    duty: Floats
    heat_w: Floats
    door: Floats
    day: Floats
    slope: Floats


def linearise(twin: BoxTwin, runs: RunBatch) -> LinearSteps:
    """Linearise `twin` about each row of `runs`.

    Errors : DataError naming a column that is missing, or `day0_utc`
    """
    acting = _acting(twin, runs)
    places, index = _distinct(acting)
    table, drives = _whole_steps(twin, acting, places)
    drives[..., 2] /= twin.system.air_capacity_j_k
    by_any = drives.sum(axis=0)[index]
    duty, room, heat = np.ascontiguousarray(by_any.transpose(3, 0, 1, 2))
    by_duty = _input_effect(drives[..., 0], index, duty, acting.duty)
    driven = _input_effect(drives[..., 2], index, heat, acting.heat_w)
    driven += by_duty
    driven += room * twin.signals.room(runs.ambient.T)[..., None]
    return LinearSteps(twin.states, table, index, driven, by_duty, room, heat)


class EnsembleRun(NamedTuple):
    """A run to simulate: steps, from a start [B, n] (None: 0), driven [N, B, n] (None: by nothing)."""

    steps: LinearSteps
    start: Floats | None
    driven: Floats | None


def responses(wanted: Sequence[EnsembleRun]) -> Floats:
    """Return the sensor's reading after each row, [len(wanted), B, N]."""
    # Twins of fewer states are padded with zeros, so that one loop over the rows serves all of them.
    rows, runs = wanted[0].steps.index.shape
    size = max(len(item.steps.states) for item in wanted)
    tables, index, offset = [], np.empty((rows, len(wanted), runs), dtype=np.intp), 0
    state = np.zeros((len(wanted), runs, size))
    driven = np.zeros((rows, len(wanted), runs, size))
    known: dict[int, int] = {}  # several responses of the same steps share a table
    for i, (steps, start, drive) in enumerate(wanted):
        own = len(steps.states)
        if id(steps) not in known:
            known[id(steps)] = offset
            table = np.zeros((len(steps.table), size, size))
            table[:, :own, :own] = steps.table
            tables.append(table)
            offset += len(steps.table)
        index[:, i] = steps.index + known[id(steps)]
        if start is not None:
            state[i, :, :own] = start
        if drive is not None:
            driven[:, i, :, :own] = drive
    flat = index.reshape(rows, -1)
    shown = rollout(np.concatenate(tables), flat, state.reshape(-1, size), driven.reshape(rows, -1, size))
    return shown.reshape(rows, len(wanted), runs).transpose(1, 2, 0)


def _input_effect(drives: Floats, index: Indices, steady: Floats, acting: Floats) -> Floats:
    """Return the effect of an input over whole rows, [N, B, n].

    drives : [J, S, n], by the end of each kind of row; steady : [N, B, n], by an input that stays at 1
    acting : [N, J, B], the input
    """
    if (acting == acting[:, :1]).all():
        return np.asarray(steady * acting[:, 0, :, None])
    driven = np.zeros((*index.shape, drives.shape[-1]))
    for j, drive in enumerate(drives):
        driven += drive[index] * acting[:, j, :, None]
    return driven


def _acting(twin: BoxTwin, runs: RunBatch) -> _PartInputs:
    signals, shape = twin.signals, runs.fan.T.shape
    room, columns = runs.ambient.T, _columns(twin, runs)
    before = np.zeros((1, shape[1]))  # nothing is known of the time before: both off
    every = Commands(np.concatenate([before, runs.duty.T]), np.concatenate([before, runs.fan.T]))
    lengths, commands = act(signals, twin.step_s, every, twin.has_relay, twin.step_s)
    speeds, duties = commands.fan[1:], signals.duty(commands.duty[1:])
    bend = _bend(twin, runs, columns)
    door, day = (columns.get(name, np.zeros(shape)) for name in ("door_open", "day"))
    heat_w = np.empty(speeds.shape)
    for j in range(len(lengths)):
        seen = {**columns, "fan_on": speeds[:, j]}
        heat_w[:, j] = bend.level_w + signals.heat_w(np.zeros(shape), room, seen, by_temp=False)
    return _PartInputs(lengths, speeds, duties, heat_w, door, day, bend.slope_w_k)


def _columns(twin: BoxTwin, runs: RunBatch) -> dict[str, Floats]:
    """Columns that the twin's heat depends on, [N, B] each, with `day` where walls age."""
    columns = {name: column.T for name, column in columns_of(twin.needs, runs.conditions).items()}
    columns["heater_duty"] = runs.duty.T
    if twin.signals.ageing_per_day != 0.0:
        if twin.day0_utc is None:
            counter = day_counter(twin.effects)
            raise DataError(f"day0_utc: missing, the twin's {counter} counts days from it")
        days = np.round((columns["utc"] - twin.day0_utc) / DAY_S * AGES_PER_DAY) / AGES_PER_DAY
        columns["day"] = twin.signals.days(days)
    return columns


def _bend(twin: BoxTwin, runs: RunBatch, columns: Conditions) -> _Bend:
    """Return the tangent at the measured air temperature in the middle of each row, held over holes."""
    shape = runs.fan.T.shape
    if not twin.signals.bends:
        return _Bend(np.zeros(shape), np.zeros(shape))
    temps = np.stack([hold(row) for row in runs.temp])
    middle = (0.5 * (temps[:, 1:] + temps[:, :-1])).T

    def heat_w(temp: Floats) -> Floats:
        return np.asarray(twin.signals.heat_w(temp, runs.ambient.T, columns, by_temp=True))

    slope = (heat_w(middle + SLOPE_K) - heat_w(middle - SLOPE_K)) / (2.0 * SLOPE_K)
    slope = _level(slope)
    return _Bend(slope, heat_w(middle) - slope * middle)


def _level(slopes: Floats) -> Floats:
    """To one of a few values, in shares of the range, so that a fitted value moves them smoothly."""
    low, high = float(slopes.min()), float(slopes.max())
    if high - low <= 1e-12:
        return slopes
    step = (high - low) / SLOPE_LEVELS
    return low + step * np.round((slopes - low) / step)


def _distinct(acting: _PartInputs) -> tuple[Indices, Indices]:
    """Places, flat, where each kind of row occurs, and which kind each row is [N, B]."""
    modes = (*acting.fan.swapaxes(0, 1), acting.door, acting.day, acting.slope)
    varying = [mode for mode in modes if not (mode == mode.flat[0]).all()]
    if not varying:
        return np.zeros(1, dtype=np.intp), np.zeros(acting.door.shape, dtype=np.intp)
    places, which = _combinations(np.stack(varying, axis=-1).tobytes(), len(varying))
    return places, which.reshape(acting.door.shape)


@lru_cache(maxsize=64)  # twins of one search see the same fan: sorting it is what takes the time
def _combinations(content: bytes, count: int) -> tuple[Indices, Indices]:
    """Return the unique rows of `count` numbers as bytes, so that they can be cached."""
    return distinct(np.frombuffer(content).reshape(-1, count))


def _whole_steps(twin: BoxTwin, acting: _PartInputs, places: Indices) -> tuple[Floats, Floats]:
    """Return each kind of row's matrix [S, n, n], and the effect of each
    part's inputs by its end [J, S, n, 3].
    """
    system, count = twin.system, len(twin.states)
    door, day, slope = (
        mode.ravel()[places][:, None, None] for mode in (acting.door, acting.day, acting.slope)
    )
    bent = np.zeros((count, count))
    bent[:, system.states.index(AIR)] = system.drive[:, 2] / system.air_capacity_j_k
    rates = system.rates + slope * bent + door * system.other_rates[0] + day * system.other_rates[1]
    drive = system.drive + door * system.other_drive[0] + day * system.other_drive[1]
    fan = acting.fan.swapaxes(0, 1).reshape(len(acting.lengths), -1)[:, places]
    state, integral = exponentials(rates, system.fan_rates, fan, acting.lengths)
    driven = integral @ (drive + fan[..., None, None] * system.fan_drive)
    whole = state[-1]
    for j in range(len(state) - 2, -1, -1):
        driven[j] = whole @ driven[j]
        whole = whole @ state[j]
    return whole, driven
