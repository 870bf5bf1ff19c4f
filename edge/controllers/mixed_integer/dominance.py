"""Which partial plans can be dropped because another one is at least as good however both go on.

Let a and b have taken the same number of steps, a at lower cost, with free responses that differ by
d = F_a - F_b, and let the relay allow a all that it allows b. Go on from both with the same inputs. The
tracking cost phi of a step is convex, 0 at least and L-smooth, so

    phi(T + d) <= phi(T) + |phi'(T)| |d| + L d² / 2  and  |phi'(T)| <= sqrt(2 L phi(T)).

Summed (Cauchy-Schwarz), a's plan costs more than b's by at most

    cost_a - cost_b + sqrt(2 L (best - cost_b)) ||d|| + L ||d||² / 2

as far as b's completion beats the best plan known. Where that is negative, b can go.
"""

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT, PlanningProblem

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# A node is compared with so many on either side, sorted by mean free response: the more nodes, the more pay.
_NEIGHBOURS_MIN, _NEIGHBOURS_MAX, _NODES_PER_NEIGHBOUR = 4, 32, 16


def undominated(
    problem: PlanningProblem, free: Floats, cost: Floats, fan: Ints, hold: Ints, best: float, margin: float
) -> NDArray[np.bool_]:
    """Mask [M] of the nodes that no compared neighbour dominates; `margin` is left for rounding errors."""
    smooth = 2.0 * (TRACKING_WEIGHT + problem.limit_weight)
    order = np.argsort(free.sum(axis=1), kind="stable")
    free, cost, fan, hold = free[order], cost[order], fan[order], hold[order]
    reach = np.sqrt(2.0 * smooth * np.maximum(best - cost, 0.0))
    ruled = problem.fan_rules.holds > 1  # else the relay's state is no part of the future
    dead = np.zeros(len(order), dtype=bool)
    neighbours = int(np.clip(len(order) // _NODES_PER_NEIGHBOUR, _NEIGHBOURS_MIN, _NEIGHBOURS_MAX))
    for apart in range(1, min(neighbours, len(order) - 1) + 1):
        first, second = slice(None, -apart), slice(apart, None)
        difference = free[second] - free[first]
        square = np.einsum("ij,ij->i", difference, difference)
        distance = np.sqrt(square)
        over = cost[second] - cost[first]
        bent = 0.5 * smooth * square + margin
        second_dead = reach[second] * distance + bent < over
        first_dead = reach[first] * distance + bent < -over
        if ruled:
            same = fan[first] == fan[second]
            second_dead &= same & (hold[first] <= hold[second])
            first_dead &= same & (hold[second] <= hold[first])
        dead[second] |= second_dead
        dead[first] |= first_dead
    alive = np.ones(len(order), dtype=bool)
    alive[order[dead]] = False
    return alive
