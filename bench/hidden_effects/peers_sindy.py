"""pysindy on the residual derivative: a sparse discrepancy model (Kaheman, Kaiser, Strom et al. 2019).

The residual derivative is what the twin misses over a step, as heat; the library is that of `peers_terms`,
each term in units of its size. Sequentially thresholded least squares (`pysindy.STLSQ`) drops small ones,
with the largest threshold that does nearly as well as the best one on rows left out. A loss by `infiltration`
and by the fan, of about the same coefficient, is one `wall_loss`: all three at once would leave the
regression no single answer.
"""

import warnings

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.peers_regression import OneStepRegression
from bench.hidden_effects.peers_terms import TERMS

Floats = NDArray[np.float64]
THRESHOLDS = (
    0.02,
    0.05,
    0.1,
    0.15,
    0.2,
    0.3,
    0.5,
    0.8,
    10.0,
)  # share of the residual's size; the last leaves nothing
HELD_OUT = 4  # a quarter of the rows
NEARLY = 1.1
_ALIKE = 0.3  # difference of two coefficients that are one, share of the larger
_NAMES = [term.effect for term in TERMS]
_STRAIGHT, _LEAK, _BLOWN = (_NAMES.index(name) for name in ("wall_loss", "infiltration", "fan_effectiveness"))


def sindy(found: OneStepRegression) -> list[int]:
    """Return indices of the chosen terms, the largest first."""
    heat_w = found.miss / found.gain
    size = np.sqrt((found.terms**2).mean(axis=0))
    used = [i for i in range(len(TERMS)) if i != _STRAIGHT and size[i] > 0.0]
    scale = float(np.sqrt((heat_w**2).mean())) or 1.0
    design, target = found.terms[:, used] / size[used], heat_w / scale
    kept = len(target) - len(target) // HELD_OUT
    tried = {threshold: _sparse(design[:kept], target[:kept], threshold) for threshold in THRESHOLDS}
    missed = {threshold: _misfit(fitted, design[kept:], target[kept:]) for threshold, fitted in tried.items()}
    largest = max(threshold for threshold in tried if missed[threshold] <= NEARLY * min(missed.values()))
    best = _sparse(design, target, largest)
    by_term = {used[j]: float(best[j] / size[used[j]]) for j in np.argsort(-np.abs(best)) if best[j]}
    return _merge(by_term)


def _sparse(design: Floats, target: Floats, threshold: float) -> Floats:
    import pysindy

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a threshold drops every term is no news
        fitted = pysindy.STLSQ(threshold=threshold, alpha=1e-3).fit(design, target[:, None])
    return np.asarray(fitted.coef_, dtype=np.float64).ravel()


def _misfit(coefficients: Floats, design: Floats, target: Floats) -> float:
    left = target - design @ coefficients
    return float(left @ left)


def _merge(by_term: dict[int, float]) -> list[int]:
    """Loss with and without the fan, where they are the same, as one."""
    if {_LEAK, _BLOWN} <= set(by_term):
        one, other = by_term[_LEAK], by_term[_BLOWN]
        if abs(one - other) <= _ALIKE * max(abs(one), abs(other)):
            first = min(list(by_term).index(_LEAK), list(by_term).index(_BLOWN))
            order = [i for i in by_term if i not in (_LEAK, _BLOWN)]
            return [*order[:first], _STRAIGHT, *order[first:]]
    return list(by_term)
