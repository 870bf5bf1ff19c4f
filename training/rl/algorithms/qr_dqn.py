"""Quantile regression DQN: the distribution of a return, not its mean (Dabney et al., AAAI 2018)."""

from dataclasses import dataclass, replace

import torch
from sb3_contrib import QRDQN
from torch import nn

from edge.models.policy_actions import ACTIONS
from training.rl.algorithms.algorithm import falling_rate, with_last
from training.rl.boxes import World
from training.rl.settings import DqnSettings, learner_arguments
from training.rl.vec_env import BoxesVecEnv


@dataclass(frozen=True, slots=True)
class QrDqnSettings(DqnSettings):
    """Those of DQN, and the number of quantiles."""

    quantiles: int = 10
    batch: int = 256  # the time of an update goes with the batch and the square of the quantiles


def make_agent(world: World, seed: int, settings: QrDqnSettings) -> QRDQN:
    """Untrained; the outputs grow with the quantiles, and so does the time of an update."""
    return QRDQN(
        "MlpPolicy",
        BoxesVecEnv(world, settings.boxes, seed, settings.reward_scale),
        learning_rate=falling_rate(settings.learning_rate, settings.final_learning_rate),
        buffer_size=settings.buffer,
        policy_kwargs={
            "net_arch": list(settings.hidden),
            "n_quantiles": settings.quantiles,
            "optimizer_kwargs": {"fused": True},
        },
        **learner_arguments(settings, seed),
    )


@torch.no_grad()
def network_of(agent: QRDQN) -> nn.Sequential:
    """Return the network of the quantiles' mean, which is linear in them: its last layer takes it in."""
    *hidden, last = agent.policy.quantile_net.quantile_net
    assert isinstance(last, nn.Linear)
    weight, bias = (values.reshape(agent.n_quantiles, ACTIONS, -1) for values in (last.weight, last.bias))
    return with_last(nn.Sequential(*hidden), weight.mean(dim=0), bias.mean(dim=0)[:, 0])


FIRST = QrDqnSettings()
TRIALS = (
    FIRST,
    replace(FIRST, batch=512),
    replace(FIRST, learning_rate=1e-3),
    replace(FIRST, learning_rate=5e-4),
    replace(FIRST, gamma=0.9),
    replace(FIRST, target_every=1600),
)
SETTINGS = TRIALS[1]  # the highest reward of `python -m training.rl.tune`
