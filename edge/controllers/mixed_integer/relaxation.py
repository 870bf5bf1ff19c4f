"""The problem with heater and fan continuous: where to take the tangent. No proof rests on its accuracy."""

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT, PlanningProblem, lower_toeplitz
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
