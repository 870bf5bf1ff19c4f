"""Proximal policy optimisation (Schulman et al., arXiv 1707.06347) over the same 42 actions."""

from dataclasses import dataclass, replace

from stable_baselines3 import PPO
from torch import nn

from training.rl.algorithms.algorithm import falling_rate
from training.rl.boxes import World
from training.rl.vec_env import BoxesVecEnv


@dataclass(frozen=True, slots=True)
class PpoSettings:
    """boxes times rollout divides the steps, so that no more are taken."""

    steps: int = 100_000
    boxes: int = 16  # environments that step in one call
    hidden: tuple[int, ...] = (128, 128)  # of policy and value, a network each
    rollout: int = 125  # steps of each box between two updates
    batch: int = 250
    epochs: int = 10
    gamma: float = 0.95
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy: float = 0.0
    learning_rate: float = 1e-3
    final_learning_rate: float = 1e-4  # reached in a straight line
    reward_scale: float = 0.1


def make_agent(world: World, seed: int, settings: PpoSettings) -> PPO:
    """Untrained; ReLU as in all policies of a rig, where stable-baselines3 has tanh."""
    return PPO(
        "MlpPolicy",
        BoxesVecEnv(world, settings.boxes, seed, settings.reward_scale),
        learning_rate=falling_rate(settings.learning_rate, settings.final_learning_rate),
        n_steps=settings.rollout,
        batch_size=settings.batch,
        n_epochs=settings.epochs,
        gamma=settings.gamma,
        gae_lambda=settings.gae_lambda,
        clip_range=settings.clip,
        ent_coef=settings.entropy,
        policy_kwargs={
            "net_arch": list(settings.hidden),
            "activation_fn": nn.ReLU,
            "optimizer_kwargs": {"fused": True, "eps": 1e-5},
        },
        seed=seed,
        device="cpu",
    )


def network_of(agent: PPO) -> nn.Sequential:
    """Return the network of the logits."""
    return nn.Sequential(*agent.policy.mlp_extractor.policy_net, agent.policy.action_net)


FIRST = PpoSettings()
TRIALS = (
    FIRST,
    replace(FIRST, learning_rate=3e-4),
    replace(FIRST, learning_rate=2e-3),
    replace(FIRST, entropy=0.003),
    replace(FIRST, gamma=0.9),
    replace(FIRST, rollout=25, batch=100),
)
SETTINGS = TRIALS[4]  # the highest reward of `python -m training.rl.tune`
