"""Breadth-first branch and bound over the steps of the horizon, with a limited width."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import Problem
from edge.controllers.mixed_integer.tangents import Tangents
from edge.names import HEATER_LEVELS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    levels: Ints | None
    fan: Ints | None
    cost: float
    bound: float  # no plan costs less than min(bound, cost)
    nodes: int


def search(problem: Problem, bounds: Tangents, width: int, best: float, keep_first=None) -> Pass:
    n = problem.horizon
    rules = problem.fan_rules
    L = problem.heater_levels + 1
    levels_opt = np.tile(np.arange(L), 2)
    fan_opt = np.repeat([0, 1], L)
    duty = levels_opt / HEATER_LEVELS
    effort = problem.heater_weight * duty**2 + problem.fan_weight * fan_opt
    push = duty * problem.heater[0] + fan_opt * problem.fan[0]
    tol = 1e-9 * (1 + best) if np.isfinite(best) else 0.0
    cost = np.zeros(1)
    free = problem.free[None, :]
    dot = (bounds.slope @ problem.free)[None, :]  # M,K
    state = np.array([int(rules.on)])
    hold = np.array([rules.hold])
    dropped = np.inf
    nodes = 0
    trace = []
    for k in range(n):
        nodes += len(cost)
        temp = free[:, :1] + push
        track = 10.0 * (temp - problem.reference[k]) ** 2
        if problem.limit_weight:
            track += problem.limit_weight * np.maximum(temp - problem.temp_max, 0) ** 2
        new_cost = cost[:, None] + track + effort
        # fan rules
        switched = fan_opt[None, :] != state[:, None]
        bad = switched & (hold[:, None] > 0)
        new_hold = np.where(switched, np.where(fan_opt == 1, rules.min_on, rules.min_off)[None, :] - 1, np.maximum(hold[:, None] - 1, 0))
        base = dot - bounds.slope[:, k] * free[:, :1]
        gh = (bounds.heater[:, k] - bounds.slope[:, k] * problem.heater[0])
        gf = (bounds.fan[:, k] - bounds.slope[:, k] * problem.fan[0])
        add = gh[:, None] * duty + gf[:, None] * fan_opt  # K,O
        togo = None
        for i in range(bounds.slope.shape[0]):
            const = bounds.constant[i, k + 1][fan_opt[None, :], new_hold]
            t = base[:, i, None] + add[i] + const
            togo = t if togo is None else np.maximum(togo, t)
        bound = new_cost + togo
        bound[bad] = np.inf
        flat = bound.ravel()
        keep = np.flatnonzero(flat < best - tol)
        if len(keep) > width:
            b = flat[keep]
            part = np.argpartition(b, width)
            dropped = min(dropped, float(b[part[width]]))
            keep = keep[np.sort(part[:width])]
        if len(keep) == 0:
            return Pass(None, None, np.inf, dropped, nodes)
        parent, opt = np.divmod(keep, 2 * L)
        trace.append((parent, opt))
        cost = new_cost.ravel()[keep]
        state = fan_opt[opt]
        hold = new_hold.ravel()[keep]
        dot = base[parent] + add.T[opt]
        free = free[parent, 1:] + duty[opt, None] * problem.heater[1 : n - k] + fan_opt[opt, None] * problem.fan[1 : n - k]
    i = int(np.argmin(cost))
    final = float(cost[i])
    lv = np.zeros(n, int); fn = np.zeros(n, int)
    for k in range(n - 1, -1, -1):
        parent, opt = trace[k]
        lv[k], fn[k] = levels_opt[opt[i]], fan_opt[opt[i]]
        i = parent[i]
    return Pass(lv, fn, final, dropped, nodes)
