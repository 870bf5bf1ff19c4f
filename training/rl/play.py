"""A policy's episodes in a model, without exploration: what it is judged and chosen by."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.rl.boxes import EpisodeBoxes, World

Act = Callable[[NDArray[np.float32]], NDArray[np.int64]]  # observations [B, features] -> actions [B]
VALIDATION_BOXES = 64
VALIDATION_SEED = 20_001  # no training has it


@dataclass(frozen=True, slots=True)
class PlayMeans:
    """Means over all steps of all episodes."""

    mae_k: float  # of the true air against the reference of the step
    reward: float  # of a step
    duty: float
    fan: float


def play(act: Act, world: World, count: int = VALIDATION_BOXES, seed: int = VALIDATION_SEED) -> PlayMeans:
    """One episode in each of `count` boxes; the same seed gives the same rooms and references."""
    boxes = EpisodeBoxes(world, count, np.random.default_rng(seed))
    observation, steps = boxes.reset(), []
    for _ in range(world.episodes.steps):
        steps.append(boxes.step(act(observation.astype(np.float32))))
        observation = steps[-1].observation
    return PlayMeans(
        mae_k=float(np.mean([np.abs(step.error_k) for step in steps])),
        reward=float(np.mean([step.reward for step in steps])),
        duty=float(np.mean([step.duty for step in steps])),
        fan=float(np.mean([step.fan for step in steps])),
    )
