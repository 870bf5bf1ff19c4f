"""Surroundings of an experiment: the ambient and other columns hold their last recorded values."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.experiment.sequence import SequenceInputs
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
LATER_S = 3600.0  # an experiment begins so long after the last row
FAR_K = 10.0  # from the room, where no box rests: it hardly loses heat by this model


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The room's temperature [°C], other columns as constants, and when it begins (None: not known).

    swing_k : by how much the room warms and cools again in the course of it
    guessed : whether no room temperature is recorded
    """

    room_c: float
    columns: Mapping[str, float]
    utc: float | None
    guessed: bool
    swing_k: float = 0.0

    def record(self, inputs: SequenceInputs, start_c: float) -> RunBatch:
        """Return the inputs as runs of which only the first temperature is known."""
        shape = inputs.fan.shape
        temp = np.full((shape[0], shape[1] + 1), np.nan)
        temp[:, 0] = start_c
        passed = np.arange(shape[1]) / shape[1]
        room = self.room_c + self.swing_k * np.sin(np.pi * passed)
        conditions = {name: np.full(shape, value) for name, value in self.columns.items()}
        if "light" in conditions:
            conditions["light"] = inputs.light
        if self.utc is not None:
            conditions["utc"] = np.broadcast_to(self.utc + inputs.row_s * np.arange(shape[1]), shape)
        return RunBatch(temp, inputs.duty, inputs.fan, np.broadcast_to(room, shape), conditions)


def surroundings(runs: RunBatch, guessed: bool) -> Surroundings:
    """As at the end of what was recorded."""
    conditions = dict(runs.conditions)
    utc = conditions.pop("utc", None)
    columns = {
        name: 0.0 if name == "door_open" else float(np.mean(column)) for name, column in conditions.items()
    }
    return Surroundings(
        float(np.mean(runs.ambient[-1])),
        columns,
        None if utc is None else float(utc.max()) + LATER_S,
        guessed,
    )


def resting_c(twin: BoxTwin, around: Surroundings) -> float:
    """Return the sensor's reading in an undriven greenhouse at rest, the ambient where there is no rest."""
    system, signals = twin.system, twin.signals
    room = np.array([around.room_c])
    shown = signals.room(room)
    columns = {name: np.array([value]) for name, value in around.columns.items()}
    columns |= {"fan_on": np.zeros(1), "light": np.zeros(1)}
    heat_w = sum(np.asarray(signals.heat_w(shown, room, columns, by_temp)) for by_temp in (True, False))
    inputs = system.drive[:, 1] * shown + system.drive[:, 2] * heat_w / system.air_capacity_j_k
    try:
        rested = float(-np.linalg.solve(system.rates, inputs)[0])
    except np.linalg.LinAlgError:
        return around.room_c
    return rested if abs(rested - around.room_c) < FAR_K else around.room_c


def free_run(twin: BoxTwin, runs: RunBatch) -> Floats:
    """From rest at the first temperature of each run, both off before [B, N]."""
    start = at_rest(twin, runs.temp[:, 0], runs.ambient[:, 0])
    return twin.rollout(start, runs.duty, runs.fan, runs.ambient, conditions=runs.conditions)
