"""Heater levels made better for fans that are settled: one level at a time, or one up and its neighbour down.

With the fan settled the tracking cost is a convex parabola along every such move, so its best step is known
at once. Looking at the whole horizon matters where the heater is slow to act: level by level, by what the
next temperature alone says, a plan swings between off and full.
"""

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT, PlanningProblem
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
