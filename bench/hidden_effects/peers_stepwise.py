"""A plain stepwise regression: forward selection by BIC on the one-step misses."""

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.peers_regression import OneStepRegression, bic

Floats = NDArray[np.float64]
MOST_TERMS = 6


def stepwise(found: OneStepRegression) -> list[int]:
    """Indices of the chosen terms, in the order of their choice."""
    design = found.terms * found.gain[:, None]
    chosen: list[int] = []
    best = _bic(design[:, chosen], found.miss)
    while len(chosen) < MOST_TERMS:
        others = [i for i in range(design.shape[1]) if i not in chosen and design[:, i].any()]
        scores = {i: _bic(design[:, [*chosen, i]], found.miss) for i in others}
        following = min(scores, key=lambda i: scores[i], default=None)
        if following is None or not scores[following] < best:
            break
        chosen.append(following)
        best = scores[following]
    return chosen


def _bic(design: Floats, miss: Floats) -> float:
    left = miss - design @ np.linalg.lstsq(design, miss, rcond=None)[0] if design.shape[1] else miss
    return bic(left, design.shape[1])
