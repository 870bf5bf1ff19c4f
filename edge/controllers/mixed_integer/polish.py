"""Better plans near a known one: other fan commands in one or two places, then one heater level at a time.

A narrow search keeps what its bounds praise, and a relaxed fan that runs a third of every step is praised
too much; a few plans that differ in whole stretches of the fan find what it lost.

With the fan settled the tracking cost is a convex parabola along every such move, so its best step is known
at once. Looking at the whole horizon matters where the heater is slow to act: level by level, by what the
next temperature alone says, a plan swings between off and full.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT, Plan, PlanningProblem, lower_toeplitz
from edge.core.names import HEATER_LEVELS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def descend(
    problem: PlanningProblem, heater: Floats, levels: Ints, temps: Floats, sweeps: int, exchanges: bool = True
) -> tuple[Ints, Floats]:
    """Levels [B, N] and air temperatures [B, N + M] of B plans after so many sweeps over their moves.

    heater : what heater duty 1 at each step adds to all air temperatures, [N, N + M] [K]
    levels, temps : of the plans to begin with; temps must belong to them
    exchanges : besides single levels also one up, the next one down

    Above the soft limit the cost has kinks and a step may go too far: compare the costs.
    """
    levels, temps = levels.copy(), temps.copy()
    effort = problem.heater_weight / HEATER_LEVELS**2
    moves = _moves(problem.horizon, exchanges)
    pushes = moves @ heater / HEATER_LEVELS
    for _ in range(sweeps):
        moved = False
        for move, push in zip(moves, pushes, strict=True):
            curvature = _curvature(problem, push, temps) + 2.0 * effort * float(move @ move)
            if not np.all(curvature > 0.0):
                continue  # nothing that counts depends on it
            # The cost along one move is a parabola between two kinks, so its lowest level is known at once.
            slope = problem.tracking_slope(temps) @ push + 2.0 * effort * (levels @ move)
            step = _within(problem.heater_levels, levels, move, np.rint(-slope / curvature).astype(np.int64))
            if step.any():
                moved = True
                levels += step[:, None] * move
                temps += step[:, None] * push
        if not moved:
            break
    return levels, temps


def _moves(n: int, exchanges: bool) -> Ints:
    """Directions in the levels, [N or 2 N - 1, N]."""
    single = np.eye(n, dtype=np.int64)
    return np.concatenate([single, single[:-1] - single[1:]]) if exchanges else single


def _curvature(problem: PlanningProblem, push: Floats, temps: Floats) -> Floats | float:
    """Second derivative of the tracking cost along a move, one for all plans or [B]."""
    square = push * push
    curvature = 2.0 * TRACKING_WEIGHT * float(square.sum())
    if not problem.limit_weight:
        return curvature
    over: Floats = 2.0 * problem.limit_weight * ((temps > problem.temp_max) @ square)
    return curvature + over


def _within(top: int, levels: Ints, move: Ints, step: Ints) -> Ints:
    """Return the steps [B], shortened so that no level leaves 0..top."""
    up, down = levels[:, move > 0], levels[:, move < 0]
    most, least = (top - up).min(axis=1), -up.min(axis=1)
    if down.shape[1]:
        most, least = np.minimum(most, down.min(axis=1)), np.maximum(least, (down - top).max(axis=1))
    return np.asarray(np.clip(step, least, most))


_ROUNDS = 6
_LOOKED_INTO = 24  # fan plans whose heater is redone with care: the best after one quick pass
_SWEEPS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Local:
    """Air temperatures of plans near a known one, taken as linear in what they change.

    levels, fan : the known plan, [N]
    temps : its air temperatures [N + M] [°C]
    heater_response, fan_response : what duty 1 and fan on at each step add to them, [N, N + M] [K]
    """

    levels: Ints
    fan: Ints
    temps: Floats
    heater_response: Floats
    fan_response: Floats

    def temperatures(self, levels: Ints, fan: Ints) -> Floats:
        """Air temperatures of plans [B, N], [B, N + M] [°C]."""
        heated: Floats = (levels - self.levels) / HEATER_LEVELS @ self.heater_response
        return self.temps + heated + (fan - self.fan) @ self.fan_response


def polish(problem: PlanningProblem, plan: Plan) -> Plan:
    """Return the best plan after repeated small changes, `plan` itself where none is better."""
    n = problem.horizon
    heater, fan = lower_toeplitz(problem.heater, n).T, lower_toeplitz(problem.fan, n).T
    for _ in range(_ROUNDS):
        temps = problem.temperatures(plan.levels, plan.fan)
        near = neighbours(problem, Local(plan.levels, plan.fan, temps, heater, fan), 1)[0]
        cost = float(problem.cost(near.levels, near.fan))
        if not cost < plan.cost:
            break
        plan = Plan(near.levels, near.fan, cost)
    return plan


def neighbours(problem: PlanningProblem, local: Local, count: int) -> list[Plan]:
    """At most `count` allowed plans near a known one, perhaps it too, the cheapest by `local` first."""
    fan = _fan_plans(local.fan)
    fan = fan[problem.allows(np.zeros_like(fan), fan)]
    levels = np.broadcast_to(local.levels, fan.shape)
    temps = local.temperatures(levels, fan)
    quickly = descend(problem, local.heater_response, levels, temps, sweeps=1, exchanges=False)
    cost = problem.cost_at(quickly[1], quickly[0], fan)
    kept = _cheapest(cost, max(_LOOKED_INTO, count))
    fan, levels, temps = fan[kept], quickly[0][kept], quickly[1][kept]
    levels, temps = descend(problem, local.heater_response, levels, temps, _SWEEPS)
    cost = problem.cost_at(temps, levels, fan)
    return [Plan(levels[place], fan[place], float(cost[place])) for place in _cheapest(cost, count)]


def _cheapest(cost: Floats, count: int) -> Ints:
    return np.argsort(cost, kind="stable")[:count]


def fan_variants(fan: Ints) -> Ints:
    """Return each variant of the plan with one or two steps switched."""
    n = len(fan)
    one, two = np.triu_indices(n)
    flips = np.zeros((len(one), n), dtype=np.int64)
    flips[np.arange(len(one)), one] = 1
    flips[np.arange(len(one)), two] = 1
    return fan ^ flips


def _fan_plans(fan: Ints) -> Ints:
    """Return the plan, and each variant with one or two steps switched or a whole rest on or off, once."""
    n = len(fan)
    rest = np.arange(n)[None, :] >= np.arange(n)[:, None]
    plans = np.concatenate([fan[None, :], fan_variants(fan), np.where(rest, 0, fan), np.where(rest, 1, fan)])
    _, first = np.unique(plans @ (1 << np.arange(n)), return_index=True)
    return np.asarray(plans[np.sort(first)])
