"""Certified lower bound on the cost to go: a tangent of the tracking cost.

Tracking cost is convex, so with its slopes s_m at any temperatures t_m

    cost of steps k..N+M-1 >= sum_m [tracking(t_m) + s_m (T_m - t_m)] + effort,

and the right side is linear in the inputs: its minimum over the discrete inputs splits into one small
minimum per step. Every choice of t gives a true bound, whatever it was computed from; taken at the
optimum of the continuous relaxation it equals that optimum (Lagrangian duality).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import PlanningProblem, lower_toeplitz
from edge.core.names import HEATER_LEVELS

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Tangent:
    """Cost to go from step k >= constant[k, fan, hold] + slope[k:] @ (free response from step k on).

    slope : [N + M] [1/K]
    constant : [N + 1, 2, H], by the fan's state before step k and the steps its relay must still hold
    """

    slope: Floats
    constant: Floats


def tangent(problem: PlanningProblem, temps: Floats) -> Tangent:
    """Return the bound from the tangent at `temps` [N + M] [°C]."""
    slope = problem.tracking_slope(temps)
    n = problem.horizon
    heater = slope @ lower_toeplitz(problem.heater, n)  # what duty 1 at step k adds to all later steps
    fan = slope @ lower_toeplitz(problem.fan, n)
    duty = np.arange(problem.heater_levels + 1) / HEATER_LEVELS
    heater_least = (problem.heater_weight * duty**2 + heater[:, None] * duty).min(axis=1)
    intercept = problem.tracking(temps) - slope * temps
    intercept[:n] += heater_least
    return Tangent(slope, _constants(problem, intercept, problem.fan_weight + fan))


def _constants(problem: PlanningProblem, intercept: Floats, fan_cost: Floats) -> Floats:
    """Sum of `intercept` from each step on, plus the cheapest fan plan the relay allows, by recursion."""
    n, rules = problem.horizon, problem.fan_rules
    constant = np.full((n + 1, 2, rules.holds), intercept[n:].sum())
    if rules.holds == 1:
        constant[:n] += np.cumsum((intercept[:n] + np.minimum(fan_cost, 0.0))[::-1])[::-1, None, None]
        return constant
    shorter = np.maximum(np.arange(rules.holds) - 1, 0)
    for k in range(n - 1, -1, -1):
        later = constant[k + 1]
        cost = np.array([0.0, fan_cost[k]])
        stay = later[:, shorter] + cost[:, None]
        switched_on = later[1, rules.min_on - 1] + cost[1]
        switched_off = later[0, rules.min_off - 1] + cost[0]
        stay[:, 0] = np.minimum(stay[:, 0], [switched_on, switched_off])
        constant[k] = intercept[k] + stay
    return constant
