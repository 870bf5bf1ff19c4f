"""B boxes side by side: one call of the model steps them all. The environments are made of this."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.lab.episodes import Sensor
from edge.models.policy_actions import duties_and_fans
from edge.models.policy_observation import AIR_ROWS, INPUT_ROWS, Recent, observe
from training.models.window_network import WINDOW
from training.rl.episodes import Episodes, EpisodeStart
from training.rl.models import StepModel, Window
from training.rl.reward import Weights, reward

Floats = NDArray[np.float64]
START_ROWS = INPUT_ROWS + 1  # that many inputs are remembered, and the row of now


@dataclass(frozen=True, slots=True)
class World:
    """Parts that boxes are made from."""

    model: StepModel
    episodes: Episodes
    weights: Weights
    sensor: Sensor = field(default_factory=Sensor)


@dataclass(frozen=True, slots=True)
class StepResult:
    """The result of a step, [B] each; observations are [B, features]."""

    observation: Floats
    reward: Floats
    ended: NDArray[np.bool_]  # the episode's time is over
    error_k: Floats  # true air less its reference
    duty: Floats
    fan: Floats


@dataclass(frozen=True, slots=True)
class BoxesNow:
    """Knowledge of a planner before a step, [B] each; a policy knows the observation alone.

    state : of the model, [B, ...]; variant : of the model; duty, fan : as driven in the last step
    ambient, reference : [°C]
    """

    state: Floats
    variant: NDArray[np.intp]
    ambient: Floats
    reference: Floats
    duty: Floats
    fan: Floats


class EpisodeBoxes:
    """Episodes of B boxes; each ends and begins by itself."""

    def __init__(self, world: World, count: int, rng: np.random.Generator) -> None:
        self.world, self.count, self.rng = world, count, rng
        steps = world.episodes.steps
        self._reference = np.zeros((count, steps + 1))  # the last one is only looked at
        self._ambient = np.zeros((count, steps + 1))
        self._air = np.zeros((count, AIR_ROWS))  # as measured
        self._duty = np.zeros((count, INPUT_ROWS))
        self._fan = np.zeros((count, INPUT_ROWS))
        self._step = np.zeros(count, dtype=np.intp)
        self._variant = np.zeros(count, dtype=np.intp)
        self._state = np.zeros(0)

    def reset(self, which: NDArray[np.intp] | None = None) -> Floats:
        """Begin anew in the boxes `which`, or in all; the observation of all boxes."""
        boxes = np.arange(self.count) if which is None else which
        starts = [self._begin(box) for box in boxes]
        window = Window(
            *(
                np.stack([getattr(start, name)[-WINDOW:] for start in starts])
                for name in ("temp", "ambient", "duty", "fan")
            )
        )
        state = self.world.model.start(window, self._variant[boxes])
        if len(boxes) == self.count:
            self._state = state
        else:
            self._state[boxes] = state
        return self.observation()

    def observation(self) -> Floats:
        """Return the table of all boxes now, [B, features]."""
        now = np.arange(self.count), self._step
        return observe(Recent(self._air, self._duty, self._fan, self._ambient[now], self._reference[now]))

    def now(self) -> BoxesNow:
        """Return the knowledge of a planner."""
        now = np.arange(self.count), self._step
        return BoxesNow(
            self._state,
            self._variant,
            self._ambient[now],
            self._reference[now],
            self._duty[:, -1],
            self._fan[:, -1],
        )

    def step(self, actions: NDArray[np.int64]) -> StepResult:
        """One action each; a box whose episode has ended is to be reset before its next."""
        world, now = self.world, (np.arange(self.count), self._step)
        duty, fan = duties_and_fans(actions)
        self._state, air = world.model.advance(self._state, self._ambient[now], duty, fan, self._variant)
        error = air - self._reference[now]
        _push(self._air, world.sensor.shows(air, self.rng))
        _push(self._duty, duty)
        _push(self._fan, fan)
        self._step += 1
        earned = reward(error, duty, fan, world.weights)
        ended = self._step >= world.episodes.steps
        return StepResult(self.observation(), earned, ended, error, duty, fan)

    def _begin(self, box: int) -> EpisodeStart:
        """Draw an episode for a box; the rows that it begins after."""
        self._variant[box] = self.rng.integers(self.world.model.variants)
        episode = self.world.episodes.draw(self.rng)
        start = episode.start
        self._reference[box], self._ambient[box] = episode.reference, episode.ambient
        self._air[box] = start.temp[-AIR_ROWS:]
        self._duty[box], self._fan[box] = start.duty[-START_ROWS:-1], start.fan[-START_ROWS:-1]
        self._step[box] = 0
        return start


def _push(column: Floats, newest: Floats) -> None:
    """Move every row by one place and put the newest at its end."""
    column[:, :-1] = column[:, 1:]
    column[:, -1] = newest
