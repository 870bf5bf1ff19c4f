"""The likeliest values of a structure and of its noise, for the scorer."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.score_noise import ReadingNoise, Whitener, likeliest, log_likelihood, whitener
from bench.hidden_effects.score_structure import Structure

Floats = NDArray[np.float64]
_CLOSE = 1e-4  # of a sum of squares of about the number of rows: a tenth of a nat
_MOST_EVALUATIONS = 25
_WORTH_NATS = 0.1  # that a further pass must bring


class LikelihoodFit(NamedTuple):
    """log_likelihood : at the best values, without the constant; scaled : [p]"""

    log_likelihood: float
    scaled: Floats
    noise: ReadingNoise


def fit(problem: Structure, start: Floats, noise: ReadingNoise, passes: int) -> LikelihoodFit:
    """Fit the likeliest values from `start`, [p], then the likeliest noise, alternating while it helps.

    passes : at most
    """
    scaled, best = start, -np.inf
    for _ in range(passes):
        response = problem.response(scaled)
        if len(scaled):
            scaled = _least_squares(problem, scaled, response, whitener(noise, problem.measured))
        residual = problem.residual(scaled)
        noise = likeliest(noise, residual, response, problem.measured)
        before, best = best, log_likelihood(noise, residual, response, problem.measured)
        best -= 0.5 * float((problem.priors(scaled) ** 2).sum())
        if best - before < _WORTH_NATS:
            break
    return LikelihoodFit(best, scaled, noise)


def stack_columns(white: Floats, moved: Floats) -> Floats:
    """Columns [B, m, N] less what the runs' own unknowns [B, q, N] explain of them, and at which price.

    Returns : [B (N + q), m]; the sum of squares of a column is its quadratic form with those integrated out
    """
    if not white.shape[1]:
        return np.zeros((moved.shape[0] * (moved.shape[1] + moved.shape[2]), 0))
    normal = moved @ moved.swapaxes(1, 2) + np.eye(moved.shape[1])
    pull = np.linalg.solve(normal, moved @ white.swapaxes(1, 2))  # [B, q, m]
    left = white.swapaxes(1, 2) - moved.swapaxes(1, 2) @ pull
    return np.concatenate([left, pull], axis=1).reshape(-1, white.shape[1])


def _least_squares(problem: Structure, start: Floats, response: Floats, whiten: Whitener) -> Floats:
    from scipy.optimize import least_squares

    moved = whiten(response)

    def misfit(scaled: Floats) -> Floats:
        white = whiten(problem.residual(scaled)[:, None])
        return np.concatenate([stack_columns(white, moved)[:, 0], problem.priors(scaled)])

    low, high = np.array([item.bounds for item in problem.unknowns]).T
    solved = least_squares(
        misfit, start, bounds=(low, high), x_scale="jac", xtol=_CLOSE, ftol=_CLOSE, max_nfev=_MOST_EVALUATIONS
    )
    return np.asarray(solved.x, dtype=np.float64)
