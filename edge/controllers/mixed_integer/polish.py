"""Better plans near a known one: the fan changed in one or two places or for all the rest, the heater redone.

A narrow search keeps what its bounds praise, and a relaxed fan that runs a third of every step is praised
too much; a few plans that differ in whole stretches of the fan find what it lost.
"""

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import Plan, Problem
from edge.names import HEATER_LEVELS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_ROUNDS = 4


def polished(problem: Problem, plan: Plan) -> Plan:
    """The best plan found by repeated small changes of the fan; `plan` itself where none is better."""
    for _ in range(_ROUNDS):
        fan = _neighbours(plan.fan)
        fan = fan[problem.allows(np.zeros_like(fan), fan)]
        levels = _greedy_heater(problem, fan)
        costs = problem.cost(levels, fan)
        best = int(np.argmin(costs))
        if not costs[best] < plan.cost:
            break
        plan = Plan(levels[best], fan[best], float(costs[best]))
    return plan


def _neighbours(fan: Ints) -> Ints:
    """The plan itself, every one or two steps switched, every rest of it on or off."""
    n = len(fan)
    one, two = np.triu_indices(n)
    flips = np.zeros((len(one), n), dtype=np.int64)
    flips[np.arange(len(one)), one] = 1
    flips[np.arange(len(one)), two] = 1
    rest = np.arange(n)[None, :] >= np.arange(n)[:, None]
    return np.concatenate([fan[None, :], fan ^ flips, np.where(rest, 0, fan), np.where(rest, 1, fan)])


def _greedy_heater(problem: Problem, fan: Ints) -> Ints:
    """For each fan plan [B, N] the heater levels that are best step by step, looking no further."""
    n = problem.horizon
    off = np.zeros_like(fan)
    temps = problem.temperatures(off, fan)
    levels = np.arange(problem.heater_levels + 1)
    duty = levels / HEATER_LEVELS
    chosen = off
    for k in range(n):
        cost = problem.tracking(temps[:, k, None] + duty * problem.heater[0], k)
        chosen[:, k] = np.argmin(cost + problem.heater_weight * duty**2, axis=1)
        temps[:, k:] += duty[chosen[:, k], None] * problem.heater[: temps.shape[1] - k]
    return chosen
