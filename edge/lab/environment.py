"""The twin as a Gymnasium environment: `gymnasium.make("edge.lab.environment:Greenhouse-v0")`.

Importing this file registers `Greenhouse-v0`. Gymnasium is the extra `gym`; since its version 1.0 it finds no
environments by entry points of a package.

One step is one step of the twin (`sample_s`, a minute in the packaged twin). An episode begins at rest at its
first reference and ends after a fixed number of steps, never before. The reward of a step is minus its cost
(`edge.lab.cost`), by the air without the sensor's noise. No safety stands in front of the twin.
"""

from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.typing import ArrayLike, NDArray

from edge.core.errors import DataError
from edge.core.names import HEATER_LEVELS
from edge.formats.profile_file import read_profile
from edge.lab.box import SimulatedBox, conditions_at, draw_values, full_rise_k, known_twin, sensor_of
from edge.lab.cost import step_cost
from edge.lab.episodes import EpisodeSettings, Sensor, draw_ambient, draw_light, draw_reference
from edge.models.policy_actions import ACTIONS, command_of
from edge.twin.model import BoxTwin

Floats = NDArray[np.float64]
Observed = NDArray[np.float32]
ENVIRONMENT = "Greenhouse-v0"
AHEAD_STEPS = (0, 10, 30)  # references that are shown; a box of a time constant of minutes must see so far
RISE_SHARE = 0.6  # of what the full heater reaches in the end: a reference that can be reached in time
RISE_MAX_K = 15.0  # above the room; the same as in the training of the packaged policies
RISE_LEAST = 0.1  # share of the highest, of the lowest reference: a box hardly cools to the room itself


class ObservationRow(NamedTuple):
    """One number of the observation."""

    name: str
    unit: str
    low: float
    high: float


OBSERVATION = (
    ObservationRow("temp_air_c", "°C", -50.0, 500.0),  # as the sensor shows it
    ObservationRow("temp_ambient_c", "°C", -50.0, 100.0),
    ObservationRow("light", "1", 0.0, 1.0),
    ObservationRow("heater_duty", "1", 0.0, 1.0),  # of the step before
    ObservationRow("fan_on", "1", 0.0, 1.0),  # of the step before
    *(ObservationRow(f"reference_{ahead}_c", "°C", -50.0, 500.0) for ahead in AHEAD_STEPS),
)
LOW = np.array([row.low for row in OBSERVATION], dtype=np.float32)
HIGH = np.array([row.high for row in OBSERVATION], dtype=np.float32)


class Course(NamedTuple):
    """An episode: reference, room [°C] and light (0..1) by step, longer than it by what is shown ahead."""

    reference: Floats
    ambient: Floats
    light: Floats


class GreenhouseEnv(gymnasium.Env[Observed, Any]):
    """A box to heat and to cool along a reference.

    observation : [8], the rows of `OBSERVATION`; `reference_0_c` is for the end of the step that begins now,
        `reference_10_c` the same ten steps later
    action : 0..41, all levels of the heater with the fan off and then with it on, as the packaged policies
        have them (`edge.models.policy_actions`); with `continuous` [2], duty 0..1, rounded to steps of 0.05,
        and fan, on from 0.5 on
    info : `time_s`, `temp_air_c` (true), `temp_ambient_c`, `light`, `reference_c`, `heater_duty`, `fan_on`
        and `cost` of the step that has ended; `state`, the twin's true state by name (thermal nodes in °C,
        the heater in W)
    """

    metadata = {"render_modes": ["ansi"], "render_fps": 1}  # noqa: RUF012 - the name and type are Gymnasium's

    def __init__(
        self,
        twin: str | Path | None = None,
        *,
        steps: int = 240,
        reference: str | Path | ArrayLike | None = None,
        ambient_c: ArrayLike | None = None,
        light: ArrayLike | None = None,
        uncertain: bool = False,
        noise: bool = True,
        continuous: bool = False,
        effort_weight: float = 1.0,
        render_mode: str | None = None,
    ) -> None:
        """Make the environment; all chance comes from the seed of `reset`.

        twin : a twin file, None for the packaged twin
        steps : of an episode
        reference : a profile (CSV with `time_s,reference_c`), or a number or one for each step [°C], whose
            last one holds on; None: drawn anew for every episode, within what the box can reach
        ambient_c, light : room [°C] and light 0..1, a number or one for each step; None: drawn anew
        uncertain : draw the twin's values anew for every episode, each within its 95 % interval
        noise : False for a sensor without noise and steps
        effort_weight : as of `edge.lab.cost.step_cost`
        Errors : DataError naming file and key, also where a twin that is to be uncertain has no interval
        """
        self._file = known_twin(twin)
        self.twin: BoxTwin = self._file.twin()  # of this episode
        self._sensor = sensor_of(self._file) if noise else Sensor(0.0, 0.0)
        self.steps, self._uncertain, self._continuous = steps, uncertain, continuous
        rows = steps + max(AHEAD_STEPS) + 1
        self._rows = rows
        self._reference = None if reference is None else _reference(reference, rows, self.twin.step_s)
        self._ambient = None if ambient_c is None else _column("ambient_c", ambient_c, rows)
        self._light = None if light is None else _column("light", light, rows)
        self._effort_weight = effort_weight
        self.render_mode = render_mode
        self.observation_space = spaces.Box(LOW, HIGH, dtype=np.float32)
        self.action_space = spaces.Box(0.0, 1.0, (2,), np.float32) if continuous else spaces.Discrete(ACTIONS)
        self._step, self._is_begun = 0, False
        if uncertain:
            draw_values(self._file, np.random.default_rng(0))  # what cannot be drawn is refused now

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Begin an episode at rest at its first reference. options : none are known"""
        super().reset(seed=seed)
        if self._uncertain:
            self.twin = draw_values(self._file, self.np_random).twin()
        self._course = self._draw_course()
        start_c, ambient_c = float(self._course.reference[0]), float(self._course.ambient[0])
        self._box, self._is_begun = SimulatedBox(self.twin, start_c, ambient_c), True
        self._step, self._duty, self._fan, self._cost = 0, 0.0, 0.0, 0.0
        self._shown_c = self._show()
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Hold an action for one step. Errors: ResetNeeded before an episode and after its end"""
        if not self._is_begun or self._step >= self.steps:
            raise ResetNeeded("Greenhouse-v0: call reset first, also after an episode has ended")
        k = self._step
        self._duty, self._fan = self._inputs(action)
        time_s = np.array([k * self.twin.step_s])
        conditions = conditions_at(self.twin, time_s, self._course.light[k : k + 1])
        self._box.advance(self._duty, self._fan, self._course.ambient[k : k + 1], conditions)
        error_k = self._box.temp_c - float(self._course.reference[k])
        self._cost = step_cost(error_k, self._duty, self._fan, self._effort_weight)
        self._step += 1
        self._shown_c = self._show()
        return self._observation(), -self._cost, False, self._step >= self.steps, self._info()

    def render(self) -> str | None:
        """Return one line about the step that has ended, None without a render mode."""
        if self.render_mode is None or not self._is_begun:
            return None
        now = self._info()
        return (
            f"{now['time_s'] / 60.0:6.1f} min  air {now['temp_air_c']:6.2f} °C"
            f"  reference {now['reference_c']:6.2f} °C  room {now['temp_ambient_c']:6.2f} °C"
            f"  heater {now['heater_duty']:4.2f}  fan {now['fan_on']:1.0f}  cost {now['cost']:8.2f}"
        )

    def _inputs(self, action: Any) -> tuple[float, float]:
        """Return duty and fan of an action, both 0..1; NaN is off."""
        if not self._continuous:
            command = command_of(int(action))
            return command.heater_duty, command.fan
        duty, fan = (float(value) for value in action)
        level = round(min(duty, 1.0) * HEATER_LEVELS) if duty > 0.0 else 0
        return level / HEATER_LEVELS, float(fan >= 0.5)

    def _draw_course(self) -> Course:
        """Draw what is not fixed; the same numbers are drawn whether or not another column is fixed."""
        room_rng, reference_rng, light_rng = self.np_random.spawn(3)
        settings = EpisodeSettings(self._rows - 1)
        ambient = draw_ambient(room_rng, settings) if self._ambient is None else self._ambient
        light = draw_light(light_rng, settings) if self._light is None else self._light
        if self._reference is not None:
            return Course(self._reference, ambient, light)
        room_c = float(ambient.mean())
        top_k = min(RISE_SHARE * full_rise_k(self.twin), RISE_MAX_K)
        reachable = EpisodeSettings(
            self._rows,
            reference_c=(room_c + RISE_LEAST * top_k, room_c + top_k),
            above_room_k=RISE_LEAST * top_k,
        )
        return Course(draw_reference(reference_rng, reachable, room_c), ambient, light)

    def _show(self) -> float:
        return float(self._sensor.shows(np.array(self._box.temp_c), self.np_random))

    def _observation(self) -> Observed:
        course, k = self._course, self._step
        ahead = [course.reference[k + steps] for steps in AHEAD_STEPS]
        row = [self._shown_c, course.ambient[k], course.light[k], self._duty, self._fan, *ahead]
        return np.clip(np.array(row, dtype=np.float32), LOW, HIGH)

    def _info(self) -> dict[str, Any]:
        past = max(self._step - 1, 0)
        return {
            "time_s": self._step * self.twin.step_s,
            "temp_air_c": self._box.temp_c,
            "temp_ambient_c": float(self._course.ambient[past]),
            "light": float(self._course.light[past]),
            "reference_c": float(self._course.reference[past]),
            "heater_duty": self._duty,
            "fan_on": self._fan,
            "cost": self._cost,
            "state": dict(zip(self.twin.states, self._box.state.tolist(), strict=True)),
        }


def _reference(reference: str | Path | ArrayLike, rows: int, step_s: float) -> Floats:
    """Return the reference of each step. Errors: DataError for a profile without one"""
    if not isinstance(reference, str | Path):
        return _column("reference", reference, rows)
    profile = read_profile(Path(reference))
    if not profile.is_reference:
        raise DataError(f"{reference}: reference_c: missing")
    return np.array([profile.at(k * step_s)["reference_c"] for k in range(rows)])


def _column(name: str, values: ArrayLike, rows: int) -> Floats:
    """Return a column of `rows`, its last value held on. Errors: DataError for one that is not finite"""
    column = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if column.ndim != 1 or not len(column) or not np.isfinite(column).all():
        raise DataError(f"{name}: not a number, nor finite numbers by step")
    return np.append(column, np.full(max(rows - len(column), 0), column[-1]))[:rows]


if ENVIRONMENT not in gymnasium.registry:
    gymnasium.register(ENVIRONMENT, entry_point="edge.lab.environment:GreenhouseEnv")
