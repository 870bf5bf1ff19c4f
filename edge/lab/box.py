"""A box that a twin plays: stepped command by command, with a sensor, and with other parameters if wanted."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import edge.models
from edge.core.errors import DataError
from edge.lab.episodes import Sensor
from edge.twin.model import BoxTwin
from edge.twin.rollout import Commands
from edge.twin.signals import Conditions
from edge.twin.twin_file import TwinFile, read_twin_file
from edge.twin.value import Value
from edge.twin.warm_start import at_rest

Floats = NDArray[np.float64]
PACKAGED_TWIN = Path(edge.models.__file__).parent / "default_bundle" / "twin.yaml"
FORGOTTEN = 30.0  # time constants after which nothing is left of a fan that spins up: exp(-30) is rounding
REL_HUMIDITY_PCT = 50.0  # of a twin that needs it; an ordinary heated room


def known_twin(path: str | Path | None) -> TwinFile:
    """Read a twin file, the packaged one for None.

    Errors : DataError naming file and key, also for a value that is still to be fitted
    """
    source = PACKAGED_TWIN if path is None else Path(path)
    file = read_twin_file(source)
    if waiting := file.to_fit():
        raise DataError(f"{source}: {'.'.join(waiting[0])}: is still to be fitted")
    return file


def draw_values(file: TwinFile, rng: np.random.Generator) -> TwinFile:
    """Return a twin file whose fitted values are drawn, each uniformly between its `low` and `high`.

    Errors : DataError where no value has an interval
    """
    bounds = {
        place: (value.low, value.high)
        for place, value in file.values().items()
        if value.low is not None and value.high is not None
    }
    if not bounds:
        raise DataError("no value of the twin has a confidence interval")
    values = {place: Value(float(rng.uniform(low, high))) for place, (low, high) in bounds.items()}
    return file.with_values(values)


def sensor_of(file: TwinFile) -> Sensor:
    """Return the sensor of a twin file; a value that the file does not know is the usual one."""
    usual = Sensor()
    noise_sd_k, step_k = file.sensor.get("noise_sd_k"), file.sensor.get("quantisation_k")
    return Sensor(
        usual.noise_sd_k if noise_sd_k is None else noise_sd_k,
        usual.quantisation_k if step_k is None else step_k,
    )


def full_rise_k(twin: BoxTwin) -> float:
    """Return how far the full heater lifts the air above the room in the end; infinity without any loss."""
    try:
        states = np.linalg.solve(-twin.system.rates, twin.system.drive[:, 0])
    except np.linalg.LinAlgError:
        return math.inf
    rise = float(states[0]) * float(twin.signals.duty(np.ones(())))
    return rise if rise > 0.0 else math.inf


def conditions_at(twin: BoxTwin, time_s: Floats, light: Floats) -> Conditions:
    """Return the columns that effects may need beside the room: a dark window, ordinary humidity.

    time_s : since the start, [N]; light : [N], 0..1
    """
    return {
        "light": light,
        "rel_humidity": np.full(len(time_s), REL_HUMIDITY_PCT),
        "solar": np.zeros(len(time_s)),
        "utc": (twin.day0_utc or 0.0) + time_s,
    }


class SimulatedBox:
    """A twin stepped command by command. Equal commands give the temperatures of the twin's own rollout.

    state : [n], in the order of `twin.states`
    """

    def __init__(self, twin: BoxTwin, temp_c: float, ambient_c: float, step_s: float | None = None) -> None:
        """Begin at rest at `temp_c`, with the heat that holds it.

        step_s : of one step [s], None for the twin's own
        """
        self.twin = twin
        self.step_s = twin.step_s if step_s is None else step_s
        self.state: Floats = at_rest(twin, temp_c, ambient_c)
        self._past = Commands(np.zeros(1), np.zeros(1))
        signals = twin.signals
        remembered_s = max(signals.heater_dead_s, signals.fan_dead_s) + FORGOTTEN * signals.fan_lag_s
        self._past_rows = 1 + math.ceil(remembered_s / self.step_s)

    @property
    def temp_c(self) -> float:
        """Air temperature as the sensor would show it without noise [°C]."""
        return float(self.state[0])

    def advance(self, duty: float, fan: float, ambient_c: Floats, conditions: Conditions) -> None:
        """Hold one command over the next N steps.

        duty, fan : 0..1; ambient_c : [N] [°C]; conditions : as `conditions_at`, [N] each
        Errors : DataError naming a column that the twin needs and that is missing
        """
        rows = len(ambient_c)
        commands = Commands(np.full((1, rows), duty), np.full((1, rows), fan))
        march = self.twin.march(
            commands, ambient_c, conditions=conditions, before=self._past, step_s=self.step_s
        )
        states = self.state[None]
        for k in range(rows):
            states = march.step(k, states)
        self.state = states[0]
        self._past = Commands(
            *(
                np.append(past, new[0])[-self._past_rows :]
                for past, new in zip(self._past, commands, strict=True)
            )
        )
