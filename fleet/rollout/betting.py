"""Evidence against a bound on a mean that may be looked at after each value: bets at fair odds.

Who bets a share of their capital on each value being above `mean` gains nothing on average where it is not.
So capital that once reaches 1 / error has a probability of `error` at most, however often one looks (Ville).
Waudby-Smith, Ramdas, Estimating means of bounded random variables by betting, J. R. Stat. Soc. B 86 (2024).
"""

from collections.abc import Sequence

import numpy as np

# Shares of the largest bet that can't lose everything; capital is split evenly among them before the first
# value, so that no share has to be chosen after values were seen.
SHARES = np.array([0.03, 0.06, 0.12, 0.25, 0.5, 0.9])
# Far beyond any evidence that is asked for: a wave may be held for months, and JSON has no infinity.
MOST = 1e15


def evidence_above(values: Sequence[float], mean: float, bound: float) -> float:
    """Return the most that a capital of 1 ever became by bets that the values' mean is above `mean`.

    values : in order, each within -bound..bound and with a mean of at most `mean` given those before it
        where the bets are to be fair
    Errors : ValueError for a value or mean that is not within the bound
    """
    if not abs(mean) < bound:
        raise ValueError(f"fleet.rollout: a mean of {mean} is not within the bound {bound}")
    steps = np.asarray(values, dtype=np.float64)
    if not np.all(np.abs(steps) <= bound):  # NaN too
        raise ValueError(f"fleet.rollout: a value is not within -{bound}..{bound}")
    gains = 1.0 + np.outer(steps - mean, SHARES) / (bound + mean)
    with np.errstate(over="ignore"):
        capital = np.cumprod(gains, axis=0).mean(axis=1)
    return float(min(capital.max(initial=1.0), MOST))


def evidence_below(values: Sequence[float], mean: float, bound: float) -> float:
    """Return the same for bets that the mean is below `mean`."""
    return evidence_above([-value for value in values], -mean, bound)
