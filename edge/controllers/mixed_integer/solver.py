"""Solve a planning problem inside a budget of nodes, guarded by a time box."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import Problem, fan_allowed
from edge.controllers.mixed_integer.relaxation import relaxed_temperatures
from edge.controllers.mixed_integer.search import search
from edge.controllers.mixed_integer.tangents import tangents

Ints = NDArray[np.int64]
_WIDTHS = (16, 256, 4096)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The best plan found and how good it is known to be."""

    levels: Ints  # heater in steps of 1/20, [N]
    fan: Ints  # [N]
    cost: float
    bound: float  # certified: no plan costs less
    proven: bool
    nodes: int
    time_box_fired: bool


def solve(problem: Problem, node_budget: int, time_box_s: float, node_limit=None, warm=None) -> Solution:
    """Thin version."""
    bounds = tangents(problem, relaxed_temperatures(problem)[None, :])
    rules = problem.fan_rules
    start = min(rules.hold, bounds.constant.shape[3] - 1)
    bound = float(bounds.constant[0, 0, int(rules.on), start] + bounds.slope[0] @ problem.free)
    best, cost, nodes, proven = None, np.inf, 0, False
    if warm is not None and fan_allowed(rules, warm[1]):
        best, cost = warm, float(problem.cost(*warm))
    for width in _WIDTHS:
        width = min(width, (node_budget - nodes) // problem.horizon)
        if width < 1 and best is not None:
            break
        found = search(problem, bounds, max(width, 1), cost)
        nodes += found.nodes
        if found.cost < cost:
            best, cost = (found.levels, found.fan), found.cost
        bound = max(bound, min(found.bound, cost))
        if found.bound >= cost:
            proven = True
            break
    return Solution(best[0], best[1], cost, min(bound, cost), proven, nodes, False)
