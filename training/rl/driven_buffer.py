"""A replay buffer of what was really done: on a rig that is not always what was proposed."""

from typing import Any

import numpy as np
from stable_baselines3.common.buffers import ReplayBuffer


class DrivenReplayBuffer(ReplayBuffer):
    """Keeps `driven_action` of the infos in place of the action, and nothing across a gap."""

    def add(
        self,
        obs: np.ndarray,
        next_obs: np.ndarray,
        action: np.ndarray,
        reward: np.ndarray,
        done: np.ndarray,
        infos: list[dict[str, Any]],
    ) -> None:
        """One step of the one rig there is."""
        if infos[0]["gap"]:
            return
        super().add(obs, next_obs, np.array([infos[0]["driven_action"]]), reward, done, infos)
