"""The paper's reinforcement-learning controllers: what a trained policy values most of what safety allows."""

import numpy as np
from numpy.typing import NDArray

from edge.core.controller import Context
from edge.core.errors import DataError
from edge.core.messages import Decision
from edge.models.onnx_policy import OnnxPolicy
from edge.models.policy_actions import ACTIONS, allowed_actions, command_of
from edge.models.policy_observation import Floats, by_name, observe_tick

BEST_TOLD = 5
_DIGITS = 6


class Rl:
    """`RL-Off`, `RL-Off-P`, `RL-On-P` and `RL-Tr-P`: one policy each."""

    def __init__(self, name: str, policy: OnnxPolicy) -> None:
        self.name = name
        self._policy = policy

    def reset(self) -> None:
        """Nothing to forget: a policy looks at the history alone."""

    def decide(self, context: Context) -> Decision:
        """Return the allowed action of the highest value, of equal ones the first.

        Raises : DataError where observation or values are not numbers
        """
        policy = self._policy
        observation = observe_tick(context)
        values = policy.values(observation[None])[0]
        if not np.isfinite(values).all():
            raise DataError(f"{self.name}: the policy's values are not numbers")
        free = allowed_actions(context.limits, context.last_sent)
        order = np.argsort(np.where(free, -values, np.inf), kind="stable")[: free.sum()]
        why = {
            "value": _finite(values[order[0]]),
            **_margin(values, order),
            "best": [_option(int(action), values) for action in order[:BEST_TOLD]],
            "forbidden": int(ACTIONS - free.sum()),
            "observation": by_name(observation),
            "reference_c": float(context.reference[0]),
            "policy": f"{policy.name} {policy.version}",
        }
        return Decision(command_of(int(order[0])), self.name, why=why)


def _margin(values: Floats, order: NDArray[np.intp]) -> dict[str, object]:
    """By how much the choice is worth more than the next best."""
    if len(order) < 2:
        return {"runner_up": None, "margin": None}
    first, second = order[:2]
    return {"runner_up": _option(int(second), values), "margin": _finite(values[first] - values[second])}


def _option(action: int, values: Floats) -> dict[str, object]:
    command = command_of(action)
    return {"heater_duty": command.heater_duty, "fan_on": command.fan_on, "value": _finite(values[action])}


def _finite(value: float) -> float:
    return round(float(value), _DIGITS)
