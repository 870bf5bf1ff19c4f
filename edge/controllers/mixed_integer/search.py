"""Breadth-first branch and bound over the steps of the horizon, with a limited width.

A level holds the first k inputs of many plans. Its children are pruned against the best plan known, by a
certified bound on the cost to go and by dominance (dominance.py). Where more survive than the width, those
with the highest bounds are dropped, and the lowest bound among them limits what is proven.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT, Plan, PlanningProblem, lower_toeplitz
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


Ints = NDArray[np.int64]


# A node is compared with so many on either side, sorted by mean free response: the more nodes, the more pay.
_NEIGHBOURS_MIN, _NEIGHBOURS_MAX, _NODES_PER_NEIGHBOUR = 4, 32, 16


def undominated_nodes(
    problem: PlanningProblem, free: Floats, cost: Floats, fan: Ints, hold: Ints, best: float, margin: float
) -> NDArray[np.bool_]:
    """Mask [M] of the nodes that no compared neighbour dominates; `margin` is left for rounding errors."""
    # What is still to be paid is never negative and bends by at most `smooth`, so its gradient is at most
    # `reach`: near temperatures cannot differ by more than that in what they still cost.
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


_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """M partial plans.

    cost : of the steps taken, [M]
    bound : certified, on the cost of every completion, [M]
    free : air temperatures of the steps to come, and of the tail, with every further input 0 [°C]
    fan, hold : the relay's state and the steps it must still hold, [M]
    """

    cost: Floats
    bound: Floats
    free: Floats
    fan: Ints
    hold: Ints

    def only(self, mask: NDArray[np.bool_]) -> "Level":
        """Return the nodes that `mask` selects."""
        return Level(self.cost[mask], self.bound[mask], self.free[mask], self.fan[mask], self.hold[mask])


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Outcome of one search: a better plan or None; every plan not looked at costs at least `bound`."""

    plan: Plan | None
    bound: float
    nodes: int
    stopped: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Options:
    """Every input one step can have, fan off first."""

    levels: Ints
    fan: Ints
    duty: Floats
    effort: Floats
    push: Floats  # on the air temperature at the end of the step [K]


def search(
    problem: PlanningProblem,
    bounds: Tangent,
    width: int,
    best: float,
    stop: Callable[[int], bool] = lambda nodes: False,
    other_than: tuple[int, int] | None = None,
) -> SearchResult:
    """Look for a plan that costs less than `best`.

    stop : asked before each level with the nodes done
    other_than : heater level and fan that the first step must not have
    """
    options = _options(problem)
    margin = rounding_margin(best)
    level = Level(
        np.zeros(1), np.full(1, -np.inf), problem.free[None, :],
        np.array([int(problem.fan_rules.on)]), np.array([problem.fan_rules.hold]),
    )  # fmt: skip
    dropped, nodes = np.inf, 0
    trace: list[tuple[Ints, Ints]] = []
    for k in range(problem.horizon):
        if stop(nodes):
            return SearchResult(None, min(dropped, float(level.bound.min())), nodes, stopped=True)
        nodes += len(level.cost)
        cost, bound, hold = _children(problem, bounds, options, level, k)
        if k == 0 and other_than is not None:
            bound[:, (options.levels == other_than[0]) & (options.fan == other_than[1])] = np.inf
        # Only what was dropped for want of room weakens the bound; what the bound itself drops does not.
        kept = np.flatnonzero(bound < best - margin)
        if len(kept) > width:
            kept, lowest = _lowest(kept, bound.ravel()[kept], width)
            dropped = min(dropped, lowest)
        level, parent, choice = _next_level(problem, options, level, kept, cost, bound, hold)
        if len(kept) > 1 and k < problem.horizon - 1 and np.isfinite(best):
            alive = undominated_nodes(problem, level.free, level.cost, level.fan, level.hold, best, margin)
            level = level.only(alive)
            parent, choice = parent[alive], choice[alive]
        trace.append((parent, choice))
        if not len(level.cost):
            return SearchResult(None, dropped, nodes)
    total = level.cost + problem.tracking(level.free, slice(problem.horizon, None)).sum(axis=1)
    if not total.min() < best - margin:
        return SearchResult(None, dropped, nodes)
    return SearchResult(_trace_back(options, trace, total), dropped, nodes)


def rounding_margin(cost: float) -> float:
    """Left in comparisons of costs near `cost`, so that rounding errors never prove anything."""
    return _ROUNDING * (1.0 + cost) if np.isfinite(cost) else 0.0


def _options(problem: PlanningProblem) -> Options:
    count = problem.heater_levels + 1
    levels, fan = np.tile(np.arange(count), 2), np.repeat([0, 1], count)
    duty = levels / HEATER_LEVELS
    push = duty * problem.heater[0] + fan * problem.fan[0]
    return Options(levels, fan, duty, problem.effort(levels, fan), push)


def _children(
    problem: PlanningProblem, bounds: Tangent, options: Options, level: Level, k: int
) -> tuple[Floats, Floats, Ints]:
    """Cost, bound (infinite where the relay forbids it) and hold of every child, [M, options]."""
    left = len(problem.free) - k
    slope = bounds.slope[k + 1 :]
    cost = level.cost[:, None] + options.effort
    cost += problem.tracking(level.free[:, :1] + options.push, k)
    heater, fan = float(slope @ problem.heater[1:left]), float(slope @ problem.fan[1:left])
    linear = (level.free[:, 1:] @ slope)[:, None] + (heater * options.duty + fan * options.fan)
    bound = cost + linear
    if problem.fan_rules.holds == 1:  # the relay may switch at every step
        bound += bounds.constant[k + 1, 0, 0]
        return cost, bound, np.zeros(bound.shape, dtype=np.int64)
    hold, allowed = problem.fan_rules.next_hold(level.fan[:, None], level.hold[:, None], options.fan[None, :])
    bound += bounds.constant[k + 1, options.fan, hold]
    bound[~allowed] = np.inf
    return cost, bound, hold


def _lowest(kept: Ints, bound: Floats, width: int) -> tuple[Ints, float]:
    """Return the `width` nodes of lowest bound, in their order, and the lowest bound of the others."""
    split = np.argpartition(bound, width)
    return kept[np.sort(split[:width])], float(bound[split[width]])


def _next_level(
    problem: PlanningProblem,
    options: Options,
    level: Level,
    kept: Ints,
    cost: Floats,
    bound: Floats,
    hold: Ints,
) -> tuple[Level, Ints, Ints]:
    """Return the remaining children as a level, with the places of their parents and their options."""
    parent, choice = np.divmod(kept, len(options.levels))
    left = level.free.shape[1]
    free = level.free[parent, 1:] + options.duty[choice, None] * problem.heater[1:left]
    free += options.fan[choice, None] * problem.fan[1:left]
    chosen = Level(cost.ravel()[kept], bound.ravel()[kept], free, options.fan[choice], hold.ravel()[kept])
    return chosen, parent, choice


def _trace_back(options: Options, trace: list[tuple[Ints, Ints]], cost: Floats) -> Plan:
    node = int(np.argmin(cost))
    least = float(cost[node])
    choices = np.empty(len(trace), dtype=np.int64)
    for k in range(len(trace) - 1, -1, -1):
        parent, choice = trace[k]
        choices[k] = choice[node]
        node = int(parent[node])
    return Plan(options.levels[choices], options.fan[choices], least)
