"""When a plan lets heater and fan rest, so that the supervisor sees the heater's relay open.

The supervisor will hold both back once its proof is due (edge/safety/relay_proof.py), until the air has
fallen by 1 K. A plan that knows it stores heat before, and offers the rest at a step down of the reference
where that costs less.
"""

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT
from edge.controllers.twin_plan.linear_step import LinearStep

Floats = NDArray[np.float64]
FALL_K = 1.2  # the 1 K of the proof, and what the sensor's steps and noise may hide
LONGEST_STEPS = 25  # as long as the supervisor's proof at steps of a minute
AHEAD_STEPS = 60  # a proof due later may yet come about by itself


def coast_steps(step: LinearStep, state: Floats, ambient: float, disturbance: float) -> int:
    """Return the steps with everything off until the air has fallen by FALL_K from its highest."""
    drift = step.constant[0] + step.room[0] * ambient + step.heat[0] * disturbance
    highest = state[step.shown]
    for steps in range(1, LONGEST_STEPS):
        state = step.matrix[0] @ state + drift
        highest = max(highest, state[step.shown])
        if state[step.shown] <= highest - FALL_K:
            return steps
    return LONGEST_STEPS


def step_down(reference: Floats, before: float) -> int | None:
    """Return the first step of `reference` [N] that is lower by FALL_K than the one before it, [°C]."""
    found = np.flatnonzero(np.diff(reference, prepend=before) <= -FALL_K)
    return int(found[0]) if len(found) else None


def price(steps: int) -> float:
    """Return the least that the supervisor's own proof costs, at a time nobody chose: off by 1 K and back."""
    return 2.0 * TRACKING_WEIGHT * steps / 3.0
