"""Intervals that follow the errors on this rig: adaptive conformal inference on the width itself.

A calibration holds for data like those it was made from. Each forecast that missed widens the interval and
each that did not narrows it, ninefold less for a claim of 90 %, so that in the long run as many are held as
claimed, whatever the errors do: the share held differs from the claim by |log(w_T / w_0)| / (RATE T) after T.
Source: Gibbs and Candès, Adaptive conformal inference under distribution shift, NeurIPS 2021; on the width
instead of the level as Angelopoulos, Candès and Tibshirani, Conformal PID control, NeurIPS 2023, sec. 2.1 (a
level leaves 0..1 where the model extrapolates, and the interval is then all or nothing); in its logarithm,
so that a width stays above 0 and one rate suits every model.
"""

import math

from edge.forecasts.conformal import CLAIMED

RATE = 0.02  # an hour of misses widens by e^(60 * 0.02 * 0.9) = 2.9, nine hours without any narrow as much
WIDTH_MIN_K = 0.02  # a fifth of the sensor's resolution
WIDTH_MAX_K = 1e4  # a number at all: the paper's PBM is hundreds of K off after an hour


def track(half_width_k: float, residual_k: float) -> float:
    """Return the half width after one more forecast [K]. A NaN residual changes nothing."""
    if not math.isfinite(residual_k):
        return half_width_k
    missed = float(abs(residual_k) > half_width_k)
    width = half_width_k * math.exp(RATE * (missed - (1.0 - CLAIMED)))
    return min(max(width, WIDTH_MIN_K), WIDTH_MAX_K)
