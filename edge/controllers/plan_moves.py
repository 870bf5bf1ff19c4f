"""Small changes of a plan: a little more or less heat for a while, the fan switched in one or two steps."""

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.polish import Local
from edge.controllers.mixed_integer.problem import Plan, PlanningProblem

Ints = NDArray[np.int64]
_LEVELS_MORE = (1, -1, 2, -2, 5, -5)


def small_moves(problem: PlanningProblem, local: Local, count: int) -> list[Plan]:
    """At most `count` allowed plans one move from the known one, the cheapest by `local` first."""
    heated, switched = _heater_plans(local.levels, problem.heater_levels), _fan_plans(local.fan)
    levels = np.concatenate([heated, np.broadcast_to(local.levels, switched.shape)])
    fan = np.concatenate([np.broadcast_to(local.fan, heated.shape), switched])
    allowed = problem.allows(levels, fan)
    levels, fan = levels[allowed], fan[allowed]
    cost = problem.cost_at(local.temperatures(levels, fan), levels, fan)
    cheapest = np.argsort(cost, kind="stable")[:count]
    return [Plan(levels[place], fan[place], float(cost[place])) for place in cheapest]


def _heater_plans(levels: Ints, top: int) -> Ints:
    """Every stretch of steps raised or lowered, and heat moved to the step after or before, each once."""
    n = len(levels)
    first, last = np.triu_indices(n)
    step = np.arange(n)
    stretch = ((step >= first[:, None]) & (step <= last[:, None])).astype(np.int64)
    single = np.eye(n, dtype=np.int64)
    moves = [stretch * more for more in _LEVELS_MORE]
    moves += [(single[1:] - single[:-1]) * more for more in _LEVELS_MORE]
    plans = np.unique(np.clip(levels + np.concatenate(moves), 0, top), axis=0)
    return np.asarray(plans[(plans != levels).any(axis=1)])


def _fan_plans(fan: Ints) -> Ints:
    """Every one or two steps switched."""
    n = len(fan)
    one, two = np.triu_indices(n)
    flips = np.zeros((len(one), n), dtype=np.int64)
    flips[np.arange(len(one)), one] = 1
    flips[np.arange(len(one)), two] = 1
    return fan ^ flips
