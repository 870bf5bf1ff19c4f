"""The cost of one step: that of the paper's MPC, by which the tables of How it was measured judge too."""

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT


def step_cost(error_k: float, duty: float, fan: float, effort_weight: float = 1.0) -> float:
    """Return the cost of one step; the sum over a run is its cost.

    error_k : air at the end of the step less the step's reference [K]
    duty, fan : of the step, 0..1
    effort_weight : on heater and fan, 1 for the paper's `MPC-P` and 0 for its `MPC` (section MPC)
    """
    return TRACKING_WEIGHT * error_k**2 + effort_weight * (duty**2 + fan)
