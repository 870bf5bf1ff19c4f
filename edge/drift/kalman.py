"""The running twin's Kalman filter: one step on at each tick, and how far the measurement was from it."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.predictor import Columns
from edge.twin.filter import expectation, predict, update
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands
from edge.twin.signals import Conditions
from edge.twin.warm_start import at_rest, drift, spread

Floats = NDArray[np.float64]
PAST_S = 1800.0  # commands so old act no more: longer than any dead time, and ten time constants of a fan
SAME_TIME_S = 1e-3  # two times of one tick


class DriftFilterState(NamedTuple):
    """The twin's estimate at a tick."""

    time_s: float
    mean: Floats  # [n]
    covariance: Floats  # [n, n]
    begun_s: float  # when the filter began, from rest


class Innovation(NamedTuple):
    """Measured minus predicted."""

    value_k: float
    sd_k: float  # as the twin's own noise says


class Filter:
    """A Kalman filter over one twin; what never changes is computed once."""

    def __init__(self, twin: BoxTwin) -> None:
        self.twin = twin
        self._plain, self._steady = twin.signals.plain, twin.signals.steady
        self._moved = drift(twin)
        self._variance_k2 = twin.noise.sensor_k**2
        self._rows = max(2, round(PAST_S / twin.step_s))

    def begin(self, history: Columns) -> DriftFilterState | None:
        """At rest at the newest row; None where its air or room temperature is not known."""
        temp, room = float(history["temp_air_measured"][-1]), float(history["temp_ambient"][-1])
        if not (np.isfinite(temp) and np.isfinite(room)):
            return None
        now = float(history["time_s"][-1])
        return DriftFilterState(now, at_rest(self.twin, temp, room), np.diag(spread(self.twin) ** 2), now)

    def step(
        self, state: DriftFilterState, history: Columns
    ) -> tuple[DriftFilterState | None, Innovation | None]:
        """From the row of `state` to the newest one, corrected by its measurement if there is one.

        history : as `Estimator.history()`
        Returns : None for the state where the history has not its row or the twin gives no number; no
            innovation without a measurement, or over more than one step
        Errors : DataError naming a column that is missing or not known
        """
        times = history["time_s"]
        first = int(np.searchsorted(times, state.time_s - SAME_TIME_S))
        if first >= len(times) or abs(times[first] - state.time_s) > SAME_TIME_S:
            return None, None
        mean, covariance = state.mean, state.covariance
        for k in range(first, len(times) - 1):
            mean, matrix = self._advance(mean, history, k)
            fan = float(off_where_unknown(history["fan_on"][k]))
            # What the twin does not know moves the states otherwise while the fan runs.
            unknown = self._moved[0] + fan * (self._moved[1] - self._moved[0])
            covariance = predict(covariance, matrix, unknown[:, None] * unknown)
        if not np.isfinite(mean).all():
            return None, None
        measured = float(history["temp_air_measured"][-1])
        innovation = None
        if np.isfinite(measured):
            if first == len(times) - 2:
                error, variance = expectation(mean, covariance, measured, self._variance_k2)
                innovation = Innovation(error, math.sqrt(variance))
            mean, covariance = update(mean, covariance, measured, self._variance_k2)
        return DriftFilterState(float(times[-1]), mean, covariance, state.begun_s), innovation

    def _advance(self, mean: Floats, history: Columns, k: int) -> tuple[Floats, Floats]:
        """Return the state after row k's step, and the derivative of the step."""
        twin = self.twin
        past = slice(max(0, k - self._rows), k + 1)
        duty, fan = (off_where_unknown(history[name][past]) for name in ("heater_duty", "fan_on"))
        room = history["temp_ambient"][k : k + 1]
        columns = _known_inputs(history, twin.needs, k)
        if self._steady and not twin.changes_within(fan[-1:]):
            transition, which = twin.transitions(fan[-1:])
            matrix = transition.state[which[0]]
            inputs = self._inputs(float(duty[-1]), fan[-1:], room, columns)
            return matrix @ mean + transition.drive[which[0]] @ inputs, matrix
        before = Commands(duty[:-1], fan[:-1])
        march = twin.march(Commands(duty[None, -1:], fan[None, -1:]), room, conditions=columns, before=before)
        return march.step(0, mean[None])[0], march.matrix(0)[0]

    def _inputs(self, duty: float, fan: Floats, room: Floats, columns: Conditions) -> Floats:
        """Return the inputs of a step, as `edge.twin.network.INPUTS`."""
        signals = self.twin.signals
        if self._plain:
            return np.array((duty, float(room[0]), 0.0))
        heat_w = signals.heat_w(np.zeros(1), room, {**columns, "fan_on": fan}, by_temp=False)
        source = float(np.sum(heat_w)) / self.twin.system.air_capacity_j_k
        return np.array((float(signals.duty(np.array(duty))), float(signals.room(room)[0]), source))


def off_where_unknown(commands: Floats) -> Floats:
    """Commands that were not recorded count as off: the board's lease had ended."""
    return np.where(np.isfinite(commands), commands, 0.0)


def _known_inputs(history: Columns, needs: Mapping[str, str], k: int) -> dict[str, Floats]:
    """Return the needed columns at row k, the last known value holding. Errors: DataError"""
    found = {}
    for name, effect in needs.items():
        column = history.get(name, np.empty(0))[: k + 1]
        known = column[np.isfinite(column)]
        if not len(known):
            raise DataError(f"{name}: not known, the twin's {effect} needs it")
        found[name] = known[-1:]
    return found
