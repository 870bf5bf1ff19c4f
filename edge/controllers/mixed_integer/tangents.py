"""Certified lower bounds on the cost to go: tangents of the tracking cost.

Tracking cost is convex, so with slopes s_m of it at any temperatures t_m

    cost of steps k..N-1 >= sum_m [tracking(t_m) + s_m (T_m - t_m)] + effort,

and the right side is linear in the inputs: its minimum over the discrete inputs splits into one small
minimum per step. Every choice of t gives a true bound, whatever it was computed from; taken at the
optimum of the continuous relaxation it equals that optimum (Lagrangian duality).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import FanRules, Problem
from edge.names import HEATER_LEVELS

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Tangents:
    """K bounds: cost to go from step k >= constant[:, k, fan state, hold] + slope[:, k:] @ free response.

    slope : [K, N] [1/K]
    constant : [K, N + 1, 2, H], H the largest hold + 1
    heater, fan : what one step of duty 1 / fan on at step k adds to slope[:, k:] @ free response, [K, N]
    """

    slope: Floats
    constant: Floats
    heater: Floats
    fan: Floats


def tangents(problem: Problem, temps: Floats) -> Tangents:
    """Bounds from the tangents at `temps` [K, N] [°C]."""
    slope = problem.tracking_slope(temps)
    heater = _backwards(slope, problem.heater)
    fan = _backwards(slope, problem.fan)
    duty = np.arange(problem.heater_levels + 1) / HEATER_LEVELS
    effort = problem.heater_weight * duty**2
    heater_least = (effort + heater[..., None] * duty).min(axis=-1)
    intercept = problem.tracking(temps) - slope * temps + heater_least
    return Tangents(slope, _constants(problem, intercept, problem.fan_weight + fan), heater, fan)


def _backwards(slope: Floats, response: Floats) -> Floats:
    """[K, N]: entry k is sum over m >= k of slope[:, m] response[m - k]."""
    n = len(response)
    lag = np.arange(n)[:, None] - np.arange(n)[None, :]
    return slope @ np.where(lag >= 0, response[np.maximum(lag, 0)], 0.0)


def _constants(problem: Problem, intercept: Floats, fan_cost: Floats) -> Floats:
    """Sum of intercepts from each step on, plus the cheapest fan plan the relay allows (dynamic programming)."""
    count, n = intercept.shape
    rules = problem.fan_rules
    holds = max(rules.hold, rules.min_on - 1, rules.min_off - 1) + 1
    constant = np.zeros((count, n + 1, 2, holds))
    if holds == 1:
        least = intercept + np.minimum(fan_cost, 0.0)
        constant[:, :n, :, 0] = np.cumsum(least[:, ::-1], axis=1)[:, ::-1, None]
        return constant
    after = np.maximum(np.arange(holds) - 1, 0)
    first_hold = (rules.min_off - 1, rules.min_on - 1)
    for k in range(n - 1, -1, -1):
        later = constant[:, k + 1]
        for state in (0, 1):
            stay = later[:, state, after] + (fan_cost[:, k, None] if state else 0.0)
            switch = later[:, 1 - state, first_hold[1 - state]] + (0.0 if state else fan_cost[:, k])
            stay[:, 0] = np.minimum(stay[:, 0], switch)
            constant[:, k, state] = intercept[:, k, None] + stay
    return constant
