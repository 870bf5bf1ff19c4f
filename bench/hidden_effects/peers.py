"""Answers of other methods to the same cases, in the form of a diagnosis: stepwise regression and pysindy.

Their limits stand in `peers_regression`. pysindy works on the residual derivative: a sparse discrepancy model
(Kaheman, Kaiser, Strom et al. 2019).

The residual derivative is what the twin misses over a step, as heat; the library is that of
`peers_regression`, each term in units of its size. Sequentially thresholded least squares (`pysindy.STLSQ`)
drops small ones, with the largest threshold that does nearly as well as the best one on rows left out. A loss
by `infiltration` and by the fan, of about the same coefficient, is one `wall_loss`: all three at once would
leave the regression no single answer.
"""

import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.hidden_effects.peers_regression import (
    TERMS,
    Columns,
    OneStepRegression,
    bic,
    columns,
    forecast,
    regression,
)
from edge.formats.run_file import read_run
from edge.twin.model import BoxTwin
from edge.twin.twin_file import read_twin_file

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
_95 = 1.959964
MOST_TERMS = 6  # of the stepwise regression


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


def stepwise(found: OneStepRegression) -> list[int]:
    """Return indices of the chosen terms, in the order of their choice."""
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


PEERS: Mapping[str, Callable[[OneStepRegression], Sequence[int]]] = {"stepwise": stepwise, "pysindy": sindy}


def diagnose(peer: str, folder: Path) -> dict[str, Any]:
    """Return the peer's answer to a case. Errors: DataError for a case that cannot be read"""
    begun_s = time.perf_counter()
    twin, train, tests = read_case(folder)
    day0 = min(float(run.utc[0]) for run in train)
    twin = twin if twin.day0_utc is not None else replace(twin, day0_utc=day0)
    found = regression(twin, train, day0)
    chosen = PEERS[peer](found)
    values, sds = coefficients(found, chosen)
    by_effect = {TERMS[i].effect: value for i, value in zip(chosen, values, strict=True)}
    effects = [_name_effect(i, value, sd, twin) for i, value, sd in zip(chosen, values, sds, strict=True)]
    return {
        "verdict": "named" if effects else "nothing_missing",
        "effects": effects,
        "depends_on": [],
        "predictions": {
            name: {
                "before": forecast(twin, run, {}, day0).tolist(),
                "after": forecast(twin, run, by_effect, day0).tolist(),
            }
            for name, run in tests.items()
        },
        "seconds": time.perf_counter() - begun_s,
    }


def read_case(folder: Path) -> tuple[BoxTwin, list[Columns], dict[str, Columns]]:
    """Read the declared twin, training runs, and test runs by file name. Errors: DataError"""
    file = read_twin_file(folder / "twin.yaml")
    twin = file.twin()
    train = [columns(read_run(path), file.sample_s) for path in sorted(folder.glob("train_*.csv"))]
    tests = {path.name: columns(read_run(path), file.sample_s) for path in sorted(folder.glob("test_*.csv"))}
    return twin, train, tests


def coefficients(found: OneStepRegression, chosen: Sequence[int]) -> tuple[Floats, Floats]:
    """Least squares on the chosen terms, and standard deviations [W per unit of each]."""
    if not chosen:
        return np.zeros(0), np.zeros(0)
    design = found.terms[:, list(chosen)] * found.gain[:, None]
    values = np.linalg.lstsq(design, found.miss, rcond=None)[0]
    left = found.miss - design @ values
    variance = float(left @ left) / max(1, len(left) - len(values))
    spread = np.sqrt(variance * np.diag(np.linalg.pinv(design.T @ design)))
    return np.asarray(values, np.float64), spread


def _name_effect(index: int, value: float, sd: float, twin: BoxTwin) -> dict[str, Any]:
    term = TERMS[index]
    parameters = {}
    if term.parameter:
        ends = sorted(term.parameter.of(value + side * _95 * sd, twin) for side in (-1.0, 1.0))
        parameters[term.parameter.name] = {
            "value": term.parameter.of(value, twin),
            "low": ends[0],
            "high": ends[1],
            "unit": term.parameter.unit,
        }
    log_odds = 0.5 * (value / sd) ** 2 if sd > 0.0 else math.inf
    return {"name": term.effect, "alternatives": [], "log_odds": log_odds, "parameters": parameters}
