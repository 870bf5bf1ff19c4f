"""The twin with the calls of a Temperature Control Lab: `with lab() as box: box.Q1(50); box.T1`.

The package `tclab` (APMonitor, Apache 2.0) has two heaters and two sensors. Here heater 1 is the heater,
heater 2 is the fan, sensor 1 is the air and sensor 2 is the room:

    Q1 [%]   heater, in the rig's steps of 5 %
    Q2 [%]   fan; a relay is on from 50 % on, a fan with a speed runs at that share of its flow
    T1 [°C]  air, as the sensor shows it
    T2 [°C]  room
    LED [%]  light, until the next call; only a twin with heat of the lamp feels it

Time goes in whole seconds: a command acts from the second on in which it is given, and the sensor is read
once a second. No safety stands between these calls and the twin.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import RequestError
from edge.core.names import HEATER_LEVELS
from edge.lab.box import SimulatedBox, conditions_at, known_twin, sensor_of
from edge.lab.episodes import Sensor
from edge.lab.lab_time import LabClock, labtime

Floats = NDArray[np.float64]
Room = float | Callable[[float], float]  # temperature [°C], or a function of the time [s]
TICK_S = 1.0  # the step of a TCLab course, and short beside any time constant of a box
ROUNDING_S = 1e-6  # by which sums of steps may miss a whole second
ROOM_C = 21.0
FAN_ON_PCT = 50.0
ROWS_AT_ONCE = 3600  # of a long pause, so that its matrices stay small


class TwinLab:
    """A box with TCLab's calls, cold at first; its heater and fan are off once it is closed."""

    def __init__(
        self,
        twin: str | Path | None = None,
        *,
        ambient_c: Room = ROOM_C,
        seed: int = 0,
        noise: bool = True,
        time: LabClock = labtime,
    ) -> None:
        """Put the box into its room, with everything off.

        twin : a twin file, None for the packaged twin
        ambient_c : of the room [°C], or a function of the seconds since now
        seed : of the sensor's noise
        noise : False for a sensor without noise and steps
        time : `tclab.labtime` for a lab that goes by the clock of that package
        Errors : DataError naming file and key of a twin file
        """
        file = known_twin(twin)
        self._sensor = sensor_of(file) if noise else Sensor(0.0, 0.0)
        self._rng = np.random.default_rng(seed)
        self._time, self._begin_s = time, time.time()
        self._room = ambient_c
        self._box = SimulatedBox(file.twin(), self._room_c(0.0), self._room_c(0.0), TICK_S)
        self._ticks = 0
        self._q1 = self._q2 = self._light = 0.0
        self._read()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Turn heater, fan and light off."""
        self.Q1(0.0)
        self.Q2(0.0)
        self.LED(0.0)

    @property
    def sources(self) -> list[tuple[str, Callable[[], Sequence[float]] | None]]:
        """Names and functions as `tclab.Historian` takes them."""
        return [("T1", self.scan), ("T2", None), ("Q1", None), ("Q2", None)]

    @property
    def T1(self) -> float:
        """Air temperature as the sensor shows it [°C]."""
        self.update()
        return self._shown[0]

    @property
    def T2(self) -> float:
        """Room temperature as its sensor shows it [°C]."""
        self.update()
        return self._shown[1]

    def Q1(self, val: float | None = None) -> float:
        """Set the heater where `val` is given [%]; return what acts, 0 to 100 in steps of 5 %."""
        self.update()
        if val is not None:
            self._q1 = round(_percent(val) / 100.0 * HEATER_LEVELS) * 100.0 / HEATER_LEVELS
        return self._q1

    def Q2(self, val: float | None = None) -> float:
        """Set the fan where `val` is given [%]; return it, limited to 0..100. A relay is on from 50 on."""
        self.update()
        if val is not None:
            self._q2 = _percent(val)
        return self._q2

    @property
    def U1(self) -> float:
        """The heater as a value that can be read and set [%], see `Q1`."""
        return self.Q1()

    @U1.setter
    def U1(self, val: float) -> None:
        self.Q1(val)

    @property
    def U2(self) -> float:
        """The fan as a value that can be read and set [%], see `Q2`."""
        return self.Q2()

    @U2.setter
    def U2(self, val: float) -> None:
        self.Q2(val)

    def LED(self, val: float = 100.0) -> float:
        """Set the light [%]; return it, limited to 0..100."""
        self.update()
        self._light = _percent(val)
        return self._light

    def scan(self) -> tuple[float, float, float, float]:
        """Return T1, T2, Q1 and Q2."""
        self.update()
        return *self._shown, self._q1, self._q2

    @property
    def true_temp_c(self) -> float:
        """Air temperature without the sensor's noise and steps [°C], which a real lab cannot show."""
        self.update()
        return self._box.temp_c

    def update(self) -> None:
        """Let the box catch up with the time; every call of the lab does so first."""
        passed_s = self._time.time() - self._begin_s
        due = math.floor(passed_s / TICK_S + ROUNDING_S) - self._ticks
        if due <= 0:
            return
        while due > 0:
            rows = min(due, ROWS_AT_ONCE)
            self._advance(rows)
            due -= rows
        self._read()

    def _advance(self, rows: int) -> None:
        time_s = TICK_S * np.arange(self._ticks, self._ticks + rows, dtype=np.float64)
        room_c = np.array([self._room_c(second) for second in time_s.tolist()])
        twin = self._box.twin
        fan = float(self._q2 >= FAN_ON_PCT) if twin.has_relay else self._q2 / 100.0
        light = np.full(rows, self._light / 100.0)
        self._box.advance(self._q1 / 100.0, fan, room_c, conditions_at(twin, time_s, light))
        self._ticks += rows

    def _read(self) -> None:
        """Read both sensors, once a second at most: reading twice teaches nobody more."""
        true = np.array([self._box.temp_c, self._room_c(self._ticks * TICK_S)])
        air, room = self._sensor.shows(true, self._rng).tolist()
        self._shown: tuple[float, float] = air, room

    def _room_c(self, time_s: float) -> float:
        return float(self._room(time_s)) if callable(self._room) else self._room


def lab(
    twin: str | Path | None = None,
    speed: float | None = None,
    *,
    ambient_c: Room = ROOM_C,
    seed: int = 0,
    noise: bool = True,
) -> TwinLab:
    """Return a lab whose time is that of `edge.lab.clock`; the arguments as of `TwinLab`.

    speed : seconds of the lab in a real second; None: no waiting, time passes in `clock` and `labtime.sleep`
    Errors : DataError naming file and key of a twin file; RequestError for an impossible speed
    """
    labtime.set_rate(0.0 if speed is None else speed)
    return TwinLab(twin, ambient_c=ambient_c, seed=seed, noise=noise)


def setup(connected: bool = False, speedup: float | None = None) -> Callable[..., TwinLab]:
    """Return the function that makes a lab, as `tclab.setup` does.

    speedup : as `speed` of `lab`
    Errors : RequestError for a connected lab: a real rig is run by the daemon, behind its safety
    """
    if connected:
        raise RequestError("setup: there is only the twin; `greenhouse run` runs a real rig")
    return partial(lab, speed=speedup)


def _percent(value: float) -> float:
    """Limit to 0..100; a value that is not a number is 0."""
    return min(float(value), 100.0) if value > 0.0 else 0.0
