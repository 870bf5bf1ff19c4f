"""Settings of the DQN, in one place."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class DqnSettings:
    """Tuned on validation episodes in the training model alone. The paper says only the steps."""

    steps: int = 100_000
    boxes: int = 16  # environments that step in one call
    hidden: tuple[int, ...] = (128, 128)
    gamma: float = 0.95
    learning_rate: float = 2e-3
    final_learning_rate: float = 1e-4  # reached in a straight line
    buffer: int = 100_000  # transitions
    batch: int = 512  # one large update costs less than two small ones, and teaches as much
    learning_starts: int = 2_000  # environment steps before the first update
    updates: int = 1  # per step of all boxes
    target_every: int = 400  # environment steps between copies into the target network
    explore_share: float = 0.1  # of the steps, over which the share of random actions falls
    explore_from: float = 1.0
    explore_to: float = 0.05
    reward_scale: float = 0.1  # the values of a discounted sum come to order 1


@dataclass(frozen=True, slots=True)
class OnlineSettings:
    """On the rig a step is a minute, so there is time for many updates in each."""

    steps: int = 1_440
    hidden: tuple[int, ...] = (128, 128)
    gamma: float = 0.95
    learning_rate: float = 1e-3
    batch: int = 128
    learning_starts: int = 60
    updates: int = 8
    target_every: int = 20
    explore_share: float = 0.5
    explore_from: float = 1.0
    explore_to: float = 0.05
    reward_scale: float = 0.1
    checkpoint_every: int = 20  # steps that a kill may cost


ONLINE = {
    "RL-On-P": OnlineSettings(),
    # It knows already what to do: small steps, little that is tried out.
    "RL-Tr-P": OnlineSettings(
        learning_rate=2e-5,
        learning_starts=240,
        updates=2,
        target_every=100,
        explore_from=0.05,
        explore_to=0.02,
    ),
}


def learner_arguments(settings: DqnSettings | OnlineSettings, seed: int) -> dict[str, Any]:
    """Return the arguments of stable-baselines3's DQN, offline and online alike."""
    return {
        "learning_starts": settings.learning_starts,
        "batch_size": settings.batch,
        "gamma": settings.gamma,
        "train_freq": 1,
        "gradient_steps": settings.updates,
        "target_update_interval": settings.target_every,
        "exploration_fraction": settings.explore_share,
        "exploration_initial_eps": settings.explore_from,
        "exploration_final_eps": settings.explore_to,
        "seed": seed,
        "device": "cpu",
    }
