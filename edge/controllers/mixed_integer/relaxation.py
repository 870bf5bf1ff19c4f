"""The problem with heater and fan continuous: where to take tangents. Its accuracy is no part of any proof."""

import numpy as np
from numpy.typing import NDArray

from edge.controllers.mixed_integer.problem import TRACKING_WEIGHT, Problem, lower_toeplitz
from edge.names import HEATER_LEVELS

Floats = NDArray[np.float64]
_ITERATIONS = 12  # at most; an interior-point method gains a digit or more with each
_TO_BOUND = 0.95  # share of the way to the bound that a step may go
_GAP = 1e-7  # complementarity at which it stops [cost]


def relaxed_temperatures(problem: Problem) -> Floats:
    """Air temperatures [N] of inputs in their box that nearly minimise the relaxed cost [°C].

    Primal-dual interior point with Mehrotra's centring; the Newton system in the inputs is diagonal plus
    rank N, so only an N x N one is solved.
    """
    n = problem.horizon
    response = np.hstack([lower_toeplitz(problem.heater, n), lower_toeplitz(problem.fan, n)])
    high = np.repeat([max(problem.heater_levels, 1e-3) / HEATER_LEVELS, 1.0], n)
    if problem.fan_rules.hold:  # inputs that are decided already get a box without width
        held = slice(n, n + problem.fan_rules.hold)
        fixed = problem.free + response[:, held].sum(axis=1) * problem.fan_rules.on
        response[:, held] = 0.0
    else:
        fixed = problem.free
    curvature = np.repeat([2.0 * problem.heater_weight, 0.0], n)
    linear = np.repeat([0.0, problem.fan_weight], n)
    inputs, low_dual, high_dual = 0.5 * high, np.ones(2 * n), np.ones(2 * n)
    for _ in range(_ITERATIONS):
        temps = fixed + response @ inputs
        room = high - inputs
        gap = float(inputs @ low_dual + room @ high_dual) / (4 * n)
        gradient = response.T @ problem.tracking_slope(temps) + curvature * inputs + linear
        if gap < _GAP and np.abs(gradient - low_dual + high_dual).max() < 1e-6:
            break
        diagonal = curvature + low_dual / inputs + high_dual / room
        weight = 2.0 * (TRACKING_WEIGHT + problem.limit_weight * (temps > problem.temp_max))
        scaled = response / diagonal
        system = scaled @ response.T
        system[np.diag_indices(n)] += 1.0 / weight
        inverse = np.linalg.inv(system)
        
        def newton(low_target, high_target):
            right = -gradient + low_target / inputs - high_target / room
            step = right / diagonal - scaled.T @ (inverse @ (scaled @ right))
            low_step = low_target / inputs - low_dual - low_dual / inputs * step
            high_step = high_target / room - high_dual + high_dual / room * step
            return step, low_step, high_step
        zero = np.zeros(2 * n)
        step, low_step, high_step = newton(zero, zero)
        scale = min(_longest(inputs, step), _longest(room, -step))
        dual_scale = min(_longest(low_dual, low_step), _longest(high_dual, high_step))
        after = float((inputs + scale * step) @ (low_dual + dual_scale * low_step) + (room - scale * step) @ (high_dual + dual_scale * high_step)) / (4 * n)
        centre = gap * (after / gap) ** 3
        step, low_step, high_step = newton(centre - step * low_step, centre + step * high_step)
        scale = _TO_BOUND * min(_longest(inputs, step), _longest(room, -step), 1/_TO_BOUND)
        dual_scale = _TO_BOUND * min(_longest(low_dual, low_step), _longest(high_dual, high_step), 1/_TO_BOUND)
        inputs = inputs + scale * step
        low_dual = low_dual + dual_scale * low_step
        high_dual = high_dual + dual_scale * high_step
    return fixed + response @ inputs


def _longest(values: Floats, step: Floats) -> float:
    """Largest share of `step` (at most 1) that keeps `values` positive."""
    ratio = np.min(np.where(step < 0.0, values / np.where(step<0,-step,1.0), np.inf))
    return float(min(1.0, ratio))
