"""How sure a name is: learnt on development cases of all suites by `python -m bench.calibrate`.

A logistic regression on what rows that no fit saw say of the name. A likelihood alone is sure of too much:
it knows its own model, not what else there may be.
"""

import math

# As bench.calibrate printed them for 158 names of simulated cases and 5 of measured logs, which count thrice:
# intercept, and slopes of `evidence`.
INTERCEPT, NATS, RATIO = -2.86, 1.06, 1.03
MOST_SURE = 0.99  # no more can be learnt from so many cases
LIKELY = 0.4  # below it a name is only listed


def evidence(tempered_nats: float, with_k: float, without_k: float) -> tuple[float, float]:
    """Logarithms: nats, errors that go together counted once; the error without a name over that with it."""
    return math.log(max(tempered_nats, 1.0)), math.log(without_k / max(with_k, 1e-9))


def probability(numbers: tuple[float, float]) -> float:
    """Return the probability that a name, or one that cannot be told from
    it, is right, from its `evidence`.
    """
    odds = INTERCEPT + NATS * numbers[0] + RATIO * numbers[1]
    return min(MOST_SURE, 1.0 / (1.0 + math.exp(-odds)))
