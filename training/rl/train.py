"""Deep Q-learning by stable-baselines3 on boxes that step together; the same seed gives the same policy."""

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DQN
from stable_baselines3.common.logger import Logger
from torch import nn

from training.rl.boxes import World
from training.rl.play import Act
from training.rl.settings import DqnSettings, learner_arguments
from training.rl.vec_env import BoxesVecEnv


def train(world: World, seed: int, settings: DqnSettings) -> DQN:
    """Train a policy for `settings.steps` steps in the world's model."""
    torch.set_num_threads(1)  # the same sums in the same order, on every machine of a kind
    env = BoxesVecEnv(world, settings.boxes, seed, settings.reward_scale)
    agent = make_agent(env, seed, settings)
    agent.learn(settings.steps)
    return agent


def make_agent(env: BoxesVecEnv, seed: int, settings: DqnSettings) -> DQN:
    """Untrained. stable-baselines3 counts `target_update_interval` in environment steps."""
    first, last = settings.learning_rate, settings.final_learning_rate
    agent = DQN(
        "MlpPolicy",
        env,
        learning_rate=lambda left: last + (first - last) * left,
        buffer_size=settings.buffer,
        policy_kwargs={"net_arch": list(settings.hidden), "optimizer_kwargs": {"fused": True}},
        **learner_arguments(settings, seed),
    )
    agent.set_logger(Logger(None, []))  # without one each run leaves a folder in /tmp
    return agent


def greedy(network: nn.Module) -> Act:
    """Return the function that picks the action of the highest value, of equal ones the first."""

    @torch.no_grad()
    def act(observations: NDArray[np.float32]) -> NDArray[np.int64]:
        values = network(torch.from_numpy(observations))
        return np.asarray(values.argmax(dim=1).numpy())

    return act
