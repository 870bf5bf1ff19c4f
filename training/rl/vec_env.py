"""stable-baselines3's vectorised environment over `EpisodeBoxes`: all step in one call of the model."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import FEATURES
from training.rl.boxes import EpisodeBoxes, World

OBSERVATION_SPACE = spaces.Box(-np.inf, np.inf, (len(FEATURES),), np.float32)
ACTION_SPACE = spaces.Discrete(ACTIONS)


class BoxesVecEnv(VecEnv):
    """`count` boxes that share one random stream: the same seed gives the same episodes.

    reward_scale : rewards are multiplied by it
    """

    def __init__(self, world: World, count: int, seed: int, reward_scale: float = 1.0) -> None:
        super().__init__(count, OBSERVATION_SPACE, ACTION_SPACE)
        self._scale = reward_scale
        self._boxes = EpisodeBoxes(world, count, np.random.default_rng(seed))
        self._actions = np.zeros(count, dtype=np.int64)

    def reset(self) -> VecEnvObs:
        """Begin an episode in every box."""
        return self._boxes.reset().astype(np.float32)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step; a box whose time is over begins anew, what it was last is in its info."""
        stepped = self._boxes.step(self._actions)
        observation = stepped.observation.astype(np.float32)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = np.flatnonzero(stepped.ended)
        if len(ended):
            for box in ended:
                infos[box] = {"terminal_observation": observation[box], "TimeLimit.truncated": True}
            observation = self._boxes.reset(ended).astype(np.float32)
        rewards = (self._scale * stepped.reward).astype(np.float32)
        return observation, rewards, stepped.ended, infos

    def close(self) -> None:
        """Nothing is held open."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return attributes of the environment itself: the boxes have none of their own."""
        return [getattr(self, attr_name, None) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refused: what a box is comes from its world."""
        raise AttributeError(f"{attr_name}: the boxes share one world")

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Refused: the boxes have no methods of their own."""
        raise AttributeError(f"{method_name}: the boxes are no environments by themselves")

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """None is."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """There is nothing to see."""
        return [None] * self.num_envs
