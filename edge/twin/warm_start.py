"""The twin's state from the past: what the air temperature and the inputs tell of walls and element."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edge.core.errors import DataError
from edge.twin.filter import predict, update
from edge.twin.model import BoxTwin
from edge.twin.network import HEATER
from edge.twin.rollout import Commands
from edge.twin.signals import Conditions

Floats = NDArray[np.float64]
NODE_SPREAD_K = 3.0  # sd of a body's temperature about rest, before anything is known
NODE_SHARE = 0.3  # the same, of how far the air is from the room
HEATER_SPREAD = 0.3  # of the same for the heater's heat, share of its power


class PastColumns(NamedTuple):
    """Columns of M rows, oldest first; the last row is now, its inputs are not read. NaN: not known.

    conditions : further columns that the twin needs
    """

    temp: Floats
    ambient: Floats
    duty: Floats
    fan: Floats
    conditions: Conditions | None = None

    @property
    def commands(self) -> Commands:
        """Those before the last row, off where not known."""
        return Commands(np.nan_to_num(self.duty[:-1]), np.nan_to_num(self.fan[:-1]))


def at_rest(twin: BoxTwin, temp: ArrayLike, ambient: ArrayLike) -> Floats:
    """Return the steady state, fan off, with the heat that holds `temp` [°C].

    temp, ambient : scalars, or [B]. Returns : [n], or [B, n]
    """
    temps = np.asarray(temp, dtype=np.float64)
    system, size = twin.system, len(twin.states)
    if size == 1:
        return temps[..., None]
    room = twin.signals.room(np.asarray(ambient, dtype=np.float64))
    # Unknown: the hidden states and the duty that holds them. Rows in one size, as W/s is far from K/s.
    balance = np.column_stack([system.rates[:, 1:], system.drive[:, 0]])
    known = -(system.rates[:, 0] * temps[..., None] + system.drive[:, 1] * room[..., None])
    scale = np.abs(balance).max(axis=1)
    scale[scale == 0.0] = 1.0  # a node that neither another nor the heater warms
    hidden = np.linalg.lstsq(balance / scale[:, None], (known / scale).T, rcond=None)[0].T
    return np.concatenate([temps[..., None], hidden[..., : size - 1]], axis=-1)


def spread(twin: BoxTwin, excess_k: ArrayLike = 0.0) -> Floats:
    """How far (sd) the state may be from rest, the air as its sensor tells.

    excess_k : of the air over the room, scalar or [B]. Returns : [n], or [B, n]
    """
    heater_w = HEATER_SPREAD * twin.geometry.heater_max_w
    node_k = np.hypot(NODE_SPREAD_K, NODE_SHARE * np.asarray(excess_k))
    hidden = [np.full_like(node_k, heater_w) if name == HEATER else node_k for name in twin.states[1:]]
    return np.stack([np.full_like(node_k, twin.noise.sensor_k), *hidden], axis=-1)


def drift(twin: BoxTwin) -> Floats:
    """Return the effect of unknown heat over a step with the fan off and
    on, sd [2, n]; its parts go together.
    """
    return twin.off_on.drive[:, :, 2] * twin.noise.heat_w / twin.system.air_capacity_j_k


def state_now(twin: BoxTwin, past: PastColumns) -> Floats:
    """Estimate the state [n] at the last row by a Kalman filter from rest;
    the air as last measured, if it was.

    Errors : DataError when no air temperature is known, or no room temperature that the hidden states need
    """
    temps = past.temp
    if not np.isfinite(temps).any():
        raise DataError("history: no air temperature is known")
    if len(twin.states) == 1 and np.isfinite(temps[-1]):
        return np.array([temps[-1]])
    if not np.isfinite(past.ambient).any():
        raise DataError("history: no room temperature is known")
    ambient = hold(past.ambient)
    first = int(np.isfinite(temps).argmax())
    state = at_rest(twin, float(temps[first]), float(ambient[first]))
    covariance = np.diag(spread(twin) ** 2)
    off, on = drift(twin)
    # One unknown heat moves all states together, so its covariance is an outer product.
    unknown = off + np.nan_to_num(past.fan)[:, None] * (on - off)
    unknown_variance = unknown[:, :, None] * unknown[:, None, :]
    measured, sensor_variance = temps.tolist(), twin.noise.sensor_k**2
    advance = _advances(twin, past, ambient)
    for k in range(first, len(temps) - 1):
        state, matrix = advance(k, state)
        covariance = predict(covariance, matrix, unknown_variance[k])
        state, covariance = update(state, covariance, measured[k + 1], sensor_variance)
    if np.isfinite(temps[-1]):
        state[0] = temps[-1]  # other predictors start there too
    return state


def _advances(
    twin: BoxTwin, past: PastColumns, ambient: Floats
) -> Callable[[int, Floats], tuple[Floats, Floats]]:
    """Return the function of step k: the state after it, and its derivative."""
    duty, fan = past.commands
    if twin.signals.plain:
        matrices, driven = twin.steps(ambient[:-1], duty, fan)

        def plain(k: int, state: Floats) -> tuple[Floats, Floats]:
            return driven[k] + np.einsum("ij,j->i", matrices[k], state), matrices[k]

        return plain
    columns = {name: hold(column)[:-1] for name, column in (past.conditions or {}).items()}
    march = twin.march(Commands(duty[None], fan[None]), ambient[:-1], conditions=columns)
    return lambda k, state: (march.step(k, state[None])[0], march.matrix(k)[0])


def hold(values: Floats) -> Floats:
    """Return a column without holes: the last known value holds, the first also before it; all NaN stays."""
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return values
    newest = np.searchsorted(known, np.arange(len(values)), side="right") - 1
    return values[known[np.maximum(newest, 0)]]
