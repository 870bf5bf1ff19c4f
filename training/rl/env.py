"""The greenhouse as a Gymnasium environment: one box whose step is a predictive model."""

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from training.rl.boxes import EpisodeBoxes, World
from training.rl.vec_env import ACTION_SPACE, OBSERVATION_SPACE

Observation = NDArray[np.float32]


class GreenhouseEnv(gymnasium.Env[Observation, np.int64]):
    """Observation as `edge.models.policy_observation.FEATURES`, actions as `edge.models.policy_actions`.

    A step is a minute; an episode never terminates, it is truncated when its time is over. `info` holds
    `error_k` (true air less its reference), `duty` and `fan`.
    """

    metadata = {"render_modes": []}  # noqa: RUF012
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self, world: World) -> None:
        self._boxes = EpisodeBoxes(world, 1, self.np_random)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; with a seed the same one as at any other time."""
        super().reset(seed=seed)
        self._boxes.rng = self.np_random
        return self._boxes.reset()[0].astype(np.float32), {}

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold the action for a minute."""
        stepped = self._boxes.step(np.array([action]))
        info = {name: float(getattr(stepped, name)[0]) for name in ("error_k", "duty", "fan")}
        earned, ended = float(stepped.reward[0]), bool(stepped.ended[0])
        return stepped.observation[0].astype(np.float32), earned, False, ended, info
