"""Solve a planning problem inside a budget of nodes and a time box, from the continuous relaxation to a
plan.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.polish import polish
from edge.controllers.mixed_integer.problem import (
    TRACKING_WEIGHT,
    Ints,
    Plan,
    PlanningProblem,
    lower_toeplitz,
)
from edge.controllers.mixed_integer.search import Tangent, rounding_margin, search, tangent
from edge.controllers.mixed_integer.time_box import TimeBox
from edge.core.names import HEATER_LEVELS

Floats = NDArray[np.float64]
_ITERATIONS = 12
_GAP = 1e-5  # mean complementarity at which it stops; the bound is then loose by about 4 N times this
_TO_BOUND = 0.95  # share of the way to a bound that a step may go
_NARROW = 1e-3  # width of the box of a heater that is capped at 0
_SIDES = np.array([[1.0], [-1.0]])  # how the distances to the lower and to the upper bound grow with an input


def relaxed_temperatures(problem: PlanningProblem) -> Floats:
    """Air temperatures [N + M] of inputs in their box that nearly minimise the relaxed cost [°C].

    Mehrotra's primal-dual interior point (Nocedal and Wright, Numerical Optimization, ch. 16.6). The Newton
    system in the inputs is diagonal plus rank N + M, so only a matrix of N + M rows is inverted.
    """
    n = problem.horizon
    response = np.hstack([lower_toeplitz(problem.heater, n), lower_toeplitz(problem.fan, n)])
    held = slice(n, n + problem.fan_rules.hold)  # the relay's state there is no choice
    fixed = problem.free + response[:, held].sum(axis=1) * problem.fan_rules.on
    response[:, held] = 0.0
    high = np.repeat([problem.heater_levels / HEATER_LEVELS + _NARROW * (problem.heater_levels == 0), 1.0], n)
    curvature = np.repeat([2.0 * problem.heater_weight, 0.0], n)
    linear = np.repeat([0.0, problem.fan_weight], n)
    inputs = 0.5 * high
    dual = np.ones((2, 2 * n))
    for _ in range(_ITERATIONS):
        distance = np.stack([inputs, high - inputs])
        gap = float((distance * dual).mean())
        if gap < _GAP:
            break
        temps = fixed + response @ inputs
        gradient = response.T @ problem.tracking_slope(temps) + curvature * inputs + linear
        ratio = dual / distance
        diagonal = curvature + ratio.sum(axis=0)
        scaled = response / diagonal
        system = scaled @ response.T
        # Woodbury: the tracking cost is of rank N + M, so the large inverse becomes one of that size.
        weight = TRACKING_WEIGHT + problem.limit_weight * (temps > problem.temp_max)
        system[np.diag_indices(len(system))] += 0.5 / weight
        inverse = np.linalg.inv(system)
        target = np.zeros_like(dual)
        for _ in range(2):  # first straight to the optimum, then corrected towards the central path
            right = (_SIDES * target / distance).sum(axis=0) - gradient
            step = right / diagonal - scaled.T @ (inverse @ (scaled @ right))
            distance_step = _SIDES * step
            dual_step = target / distance - dual - ratio * distance_step
            reach, dual_reach = _reach(distance, distance_step), _reach(dual, dual_step)
            after = ((distance + reach * distance_step) * (dual + dual_reach * dual_step)).mean()
            target = gap * (after / gap) ** 3 - distance_step * dual_step
        inputs = inputs + reach * step
        dual = dual + dual_reach * dual_step
    return np.asarray(fixed + response @ inputs)


def _reach(values: Floats, step: Floats) -> float:
    """Share of `step`, at most 1, after which all `values` are still positive."""
    return float(_TO_BOUND / max(_TO_BOUND, (-step / values).max()))


_WIDTHS = (16, 128, 1024, 8192, 32768)  # each search is wider than the one before, until one drops nothing
_POLISH_FROM = 128  # a plan that this width could not prove is worth some polish
_RUNNER_UP_WIDTH = 4
_FAN_WEIGHT_MORE = 10.0  # a plan that pays for its fan is another place to look from


@dataclass(frozen=True, slots=True)
class Solution:
    """The best plan found and how good it is known to be."""

    plan: Plan
    bound: float  # certified: no plan costs less
    proven: bool  # the plan is the cheapest, within rounding errors
    runner_up: Plan | None  # best plan found with another first step; None where there is no other
    nodes: int  # partial plans looked into
    time_box_fired: bool

    @property
    def gap(self) -> float:
        """How much the plan may cost above the cheapest, as a share of its cost."""
        return (self.plan.cost - self.bound) / self.plan.cost if self.plan.cost > self.bound else 0.0


def solve(
    problem: PlanningProblem,
    node_budget: int,
    time_box: TimeBox,
    node_limit: int | None = None,
    warm: tuple[Ints, Ints] | None = None,
) -> Solution:
    """Return the cheapest plan, or the best one found within the budget or the time.

    node_budget : nodes that may be looked into; the same budget gives the same plan, bit for bit
    time_box : once over, no further level is begun; without `warm` the first, narrow search ends
    node_limit : stop where a time box fired after so many nodes, to replay that solve
    warm : heater levels and fan to start from, used where they are allowed
    """
    bounds = tangent(problem, relaxed_temperatures(problem))
    best = _warm_plan(problem, warm)
    narrow, bound, nodes = best, _root_bound(problem, bounds), 0
    width = max(1, _next_width(0, node_budget // problem.horizon))
    while width:
        if best is None:
            found = search(problem, bounds, width, np.inf)
        else:
            stop = _stop(time_box, None if node_limit is None else node_limit - nodes)
            found = search(problem, bounds, width, best.cost, stop)
        nodes += found.nodes
        best = found.plan or best
        assert best is not None  # the first search drops no last node
        narrow = narrow or best
        margin = rounding_margin(best.cost)
        bound = max(bound, min(found.bound, best.cost) - margin)
        proven = found.bound >= best.cost - margin
        if proven or found.stopped:
            break
        # Most plans are proven by a narrow search; only one that was not is worth the polish, once.
        if width == _POLISH_FROM:
            best = polish(problem, best)
        width = _next_width(width, (node_budget - nodes) // problem.horizon)
    assert best is not None and narrow is not None
    if not (proven or found.stopped):
        best = _look_around(problem, best, narrow)
    first = int(best.levels[0]), int(best.fan[0])
    runner_up = search(problem, bounds, _RUNNER_UP_WIDTH, np.inf, other_than=first).plan
    if runner_up is not None and runner_up.cost < best.cost:
        best, runner_up = runner_up, best
    return Solution(best, min(bound, best.cost), proven, runner_up, nodes, found.stopped)


def _look_around(problem: PlanningProblem, best: Plan, narrow: Plan) -> Plan:
    """Return the best plan near three different ones: the best known, the
    first found, one with fewer fan steps.
    """
    costly = replace(problem, fan_weight=problem.fan_weight + _FAN_WEIGHT_MORE)
    sparing = search(costly, tangent(costly, relaxed_temperatures(costly)), _WIDTHS[0], np.inf).plan
    assert sparing is not None  # nothing is known that it must be better than
    priced = replace(sparing, cost=float(problem.cost(sparing.levels, sparing.fan)))
    return min((polish(problem, plan) for plan in (best, narrow, priced)), key=lambda plan: plan.cost)


def _next_width(width: int, affordable: int) -> int:
    """Return the width of the next search, as far as the nodes suffice; 0 if there is none."""
    wider = min((listed for listed in _WIDTHS if listed > width), default=0)
    return min(wider, affordable) if affordable > width else 0


def _stop(time_box: TimeBox, nodes_left: int | None) -> Callable[[int], bool]:
    """Asked before each level: is the time over, or the node reached at which it once was?"""
    return lambda nodes: time_box.is_over() or (nodes_left is not None and nodes >= nodes_left)


def _warm_plan(problem: PlanningProblem, warm: tuple[Ints, Ints] | None) -> Plan | None:
    if warm is None or len(warm[0]) != problem.horizon or not problem.allows(*warm):
        return None
    return Plan(*warm, float(problem.cost(*warm)))


def _root_bound(problem: PlanningProblem, bounds: Tangent) -> float:
    rules = problem.fan_rules
    bound = float(bounds.constant[0, int(rules.on), rules.hold] + bounds.slope @ problem.free)
    return max(bound - rounding_margin(abs(bound)), 0.0)
