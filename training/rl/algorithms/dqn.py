"""Deep Q-learning, the paper's algorithm."""

from stable_baselines3 import DQN
from torch import nn

from training.rl.algorithms.algorithm import falling_rate
from training.rl.boxes import World
from training.rl.settings import DqnSettings, learner_arguments
from training.rl.vec_env import BoxesVecEnv


def make_agent(world: World, seed: int, settings: DqnSettings) -> DQN:
    """Untrained. stable-baselines3 counts `target_update_interval` in environment steps."""
    return DQN(
        "MlpPolicy",
        BoxesVecEnv(world, settings.boxes, seed, settings.reward_scale),
        learning_rate=falling_rate(settings.learning_rate, settings.final_learning_rate),
        buffer_size=settings.buffer,
        policy_kwargs={"net_arch": list(settings.hidden), "optimizer_kwargs": {"fused": True}},
        **learner_arguments(settings, seed),
    )


def network_of(agent: DQN) -> nn.Sequential:
    """Return the Q-network."""
    return agent.policy.q_net.q_net
