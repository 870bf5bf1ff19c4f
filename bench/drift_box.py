"""A box that is a twin with noise of its own, ticked through the drift monitor, and changed on the way."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from edge.core.messages import Drift
from edge.core.predictor import Floats
from edge.drift.monitor import DriftMonitor
from edge.twin.model import BoxTwin
from edge.twin.warm_start import at_rest

ROWS = 120  # of the history that a monitor sees, as the estimator's
ROOM_C = 21.0
UTC_0 = 1_767_225_600.0  # 2026-01-01T00:00Z


@dataclass(frozen=True, slots=True)
class Chances:
    """The box's own noise; the twin's stated one is another matter."""

    sensor_k: float = 0.05
    heat_w: float = 3.0
    heat_memory_s: float = 300.0  # of the heat


@dataclass(frozen=True, slots=True)
class TickInputs:
    """One tick's."""

    duty: float
    fan: float


def switching(ticks: int, seed: int) -> list[TickInputs]:
    """Heater and fan as a thermostat might drive them: each stays a while, then changes."""
    random = np.random.default_rng(seed)
    found, duty, fan = [], 0.3, 0.0
    for _ in range(ticks):
        if random.random() < 1.0 / 20.0:
            duty = float(random.choice([0.0, 0.0, 0.2, 0.4, 0.7]))
        if random.random() < 1.0 / 15.0:
            fan = 1.0 - fan
        found.append(TickInputs(duty, fan))
    return found


@dataclass(frozen=True, slots=True)
class DriftBox:
    """The truth at a tick: the physics, further heat [W], and the sensor's bias [K]."""

    twin: BoxTwin
    heat_w: float = 0.0
    bias_k: float = 0.0


def ticks(
    monitor: DriftMonitor,
    believed: BoxTwin,
    box: Callable[[int], DriftBox],
    inputs: list[TickInputs],
    seed: int = 0,
    chances: Chances = Chances(),
    columns: Callable[[dict[str, Floats], int], None] = lambda rows, k: None,
) -> Iterator[Drift]:
    """Yield the monitor's verdict at each tick.

    believed : the twin that is watched; box : what is there at tick k
    columns : may change the rows before tick k is shown: missing readings
    """
    random = np.random.default_rng(seed)
    rows = _rows(inputs, believed.step_s)
    physics = box(0).twin
    state = at_rest(physics, ROOM_C + 2.0, ROOM_C)
    left = np.exp(-believed.step_s / chances.heat_memory_s)
    heat_w = 0.0
    for k in range(len(inputs)):
        here = box(k)
        measured = state[0] + here.bias_k + chances.sensor_k * random.standard_normal()
        rows["temp_air"][k] = rows["temp_air_measured"][k] = measured
        columns(rows, k)
        shown = {name: column[max(0, k + 1 - ROWS) : k + 1] for name, column in rows.items()}
        yield monitor.tick(believed, shown, confirmed=True)
        # A heat that wanders, since white noise is what the filter expects anyway.
        heat_w = left * heat_w + np.sqrt(1.0 - left**2) * chances.heat_w * random.standard_normal()
        source = (heat_w + here.heat_w) / here.twin.system.air_capacity_j_k
        state = here.twin.advance(state, ROOM_C, inputs[k].duty, inputs[k].fan, source)


def with_fan(twin: BoxTwin, share: float) -> BoxTwin:
    """Return the same box with a fan that moves this share of the air."""
    effects = {name: dict(values) for name, values in twin.effects.items()}
    effects["fan_effectiveness"]["eps_f"] *= share
    return replace(twin, effects=effects)


def heat_for(twin: BoxTwin, lift_k: float) -> float:
    """Constant heat into the air that moves the resting box by `lift_k` while the fan is off [W]."""
    effects = twin.effects["wall_mass"]
    loss_w_k = 1.0 / (1.0 / effects["G_in"] + 1.0 / effects["G_out"])
    return loss_w_k * lift_k


def _rows(inputs: list[TickInputs], step_s: float) -> dict[str, Floats]:
    count = len(inputs)
    time_s = step_s * np.arange(count)
    return {
        "time_s": time_s,
        "utc": UTC_0 + time_s,
        "temp_air": np.full(count, np.nan),
        "temp_air_measured": np.full(count, np.nan),
        "temp_ambient": np.full(count, ROOM_C),
        "heater_duty": np.array([item.duty for item in inputs]),
        "fan_on": np.array([item.fan for item in inputs]),
        "light": np.full(count, np.nan),
    }
