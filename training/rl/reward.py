"""The paper's reward (eq. method-rl-reward-function), with its table's weights (tab:model-parameters-rl).

Its text calls the term of lambda_2 the squared error and that of lambda_1 the absolute one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Weights:
    """lambda_2, lambda_1, lambda_0f and lambda_0h."""

    squared: float = 0.5
    absolute: float = 1.0
    fan: float = 0.0
    heater: float = 0.0


WEIGHTS = {
    "RL-Off": Weights(),
    "RL-Off-P": Weights(fan=0.5, heater=0.1),
    "RL-On-P": Weights(fan=0.5, heater=0.1),
    "RL-Tr-P": Weights(fan=0.5, heater=0.1),
}


def reward(error: Floats, duty: Floats, fan: Floats, weights: Weights) -> Floats:
    """Return the reward of one step, by its error at the end [K] and its
    inputs 0..1; scalars or arrays of one shape.
    """
    tracking = weights.squared * error**2 + weights.absolute * np.abs(error)
    return -(tracking + weights.fan * np.abs(fan) + weights.heater * np.abs(duty))
