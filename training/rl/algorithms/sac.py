"""Soft actor-critic (Haarnoja et al., arXiv 1812.05905): a continuous duty, and the fan by a threshold.

Its action is a pair of -1..1. The first one stands for the duty from 0 to 1, driven at the nearest level of
the heater; the fan is on where the second one is above 0.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import SAC
from torch import nn

from edge.core.names import HEATER_LEVELS
from edge.models.policy_actions import LEVELS
from training.rl.algorithms.algorithm import falling_rate
from training.rl.algorithms.pair_scores import HALFWAY, pair_scores
from training.rl.boxes import World
from training.rl.vec_env import BoxesVecEnv


@dataclass(frozen=True, slots=True)
class SacSettings:
    """An update for every step of all boxes, as DQN's: one of 16 environment steps."""

    steps: int = 100_000
    boxes: int = 16  # environments that step in one call
    hidden: tuple[int, ...] = (128, 128)
    gamma: float = 0.95
    learning_rate: float = 2e-3
    final_learning_rate: float = 1e-4  # reached in a straight line
    buffer: int = 100_000  # transitions
    batch: int = 256
    learning_starts: int = 2_000  # environment steps before the first update
    updates: int = 1  # per step of all boxes
    tau: float = 0.01  # share of the critics that goes into their targets at each update
    entropy: str = "auto"  # its coefficient, as stable-baselines3 takes it
    reward_scale: float = 0.1


class PairsVecEnv(BoxesVecEnv):
    """The boxes, driven by pairs of -1..1."""

    def __init__(self, world: World, count: int, seed: int, reward_scale: float) -> None:
        super().__init__(world, count, seed, reward_scale)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions that come nearest to the pairs [B, 2]."""
        super().step_async(nearest_actions(actions))


def nearest_actions(pairs: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the action that comes nearest to each pair, [B]. pairs : [B, 2]"""
    levels = np.rint(HEATER_LEVELS * (pairs[:, 0] + 1.0) / 2.0).astype(np.int64)
    return np.asarray(levels + LEVELS * (pairs[:, 1] > 0.0))


def make_agent(world: World, seed: int, settings: SacSettings) -> SAC:
    """Untrained."""
    return SAC(
        "MlpPolicy",
        PairsVecEnv(world, settings.boxes, seed, settings.reward_scale),
        learning_rate=falling_rate(settings.learning_rate, settings.final_learning_rate),
        buffer_size=settings.buffer,
        learning_starts=settings.learning_starts,
        batch_size=settings.batch,
        gamma=settings.gamma,
        tau=settings.tau,
        ent_coef=settings.entropy,
        train_freq=1,
        gradient_steps=settings.updates,
        policy_kwargs={"net_arch": list(settings.hidden), "optimizer_kwargs": {"fused": True}},
        seed=seed,
        device="cpu",
    )


def network_of(agent: SAC) -> nn.Sequential:
    """Return scores of all actions, the highest for the action nearest to the deterministic pair."""
    actor = agent.policy.actor  # the pair is the tanh of `mu`
    assert isinstance(actor.mu, nn.Linear)
    return pair_scores(actor.latent_pi, actor.mu, torch.atanh(2.0 * HALFWAY - 1.0))


FIRST = SacSettings()
TRIALS = (
    FIRST,
    replace(FIRST, learning_rate=1e-3),
    replace(FIRST, batch=512),
    replace(FIRST, tau=0.03),
    replace(FIRST, gamma=0.9),
    replace(FIRST, entropy="auto_0.1"),
)
SETTINGS = TRIALS[3]  # the highest reward of `python -m training.rl.tune`
