"""A hierarchical normal model of values: boxes about their kind, kinds about the fleet.

y = fleet mean + kind + box + error, each normal, by expectation and maximisation (Dempster, Laird & Rubin
1977). The error is what the box's own twin says of its value, so a value that its tests hardly told says
hardly anything. A box far from its kind weighs less (Student's t as a scale mixture, Lange, Little & Taylor
1989, JASA 84), so one odd box does not widen what all others tell.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
FREEDOM = 4.0  # of Student's t, boxes about their kind
ROUNDS = 200
# What a few boxes tell of spreads is little: as if so many boxes had been seen before with these.
USUAL_WITHIN, USUAL_BETWEEN, SEEN = 0.15, 0.7, 2.0
LEAST_SD = 0.03  # relative: what a twin's value may always be off


@dataclass(frozen=True, slots=True)
class ValuePrior:
    """A value's prior: mean and standard deviation, in its coordinate."""

    mean: float
    sd: float


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """A value over all kinds.

    mean, between : of the fleet, and the spread of kinds about it; within : of boxes about their kind
    kinds : posterior of each kind's mean
    """

    mean: float
    between: float
    within: float
    kinds: dict[str, ValuePrior]

    def of_kind(self, kind: str) -> ValuePrior:
        """Return what to expect of one more box; of a kind that is new, what the whole fleet tells."""
        about = self.kinds.get(kind, ValuePrior(self.mean, self.between))
        return ValuePrior(about.mean, float(np.hypot(about.sd, self.within)))


def fit_population(values: Sequence[float], errors: Sequence[float], kinds: Sequence[str]) -> Population:
    """Fit it to values [n] with standard deviations of their errors [n], of boxes each of a kind [n]."""
    y, variances = np.asarray(values, dtype=np.float64), np.square(np.asarray(errors, dtype=np.float64))
    names = sorted(set(kinds))
    member = np.array([[kind == name for kind in kinds] for name in names], dtype=np.float64)
    mean, between, within = float(np.median(y)), USUAL_BETWEEN, USUAL_WITHIN
    weights = np.ones(len(y))
    for _ in range(ROUNDS):
        own = within**2 / weights  # of a box about its kind
        centre, variance = _kinds(y, member / (own + variances), mean, between)
        told = own / (own + variances)  # share of what is off that is the box's, not an error
        squares = told**2 * ((y - member.T @ centre) ** 2 + member.T @ variance) + told * variances
        weights = (FREEDOM + 1.0) / (FREEDOM + squares / within**2)
        mean = float(np.mean(centre))
        between = _spread((centre - mean) ** 2 + variance, USUAL_BETWEEN)
        within = _spread(weights * squares, USUAL_WITHIN)
    sds = np.sqrt(variance)
    found = {name: ValuePrior(float(centre[i]), float(sds[i])) for i, name in enumerate(names)}
    return Population(mean, between, within, found)


def _spread(squares: Floats, usual: float) -> float:
    variance = (squares.sum() + SEEN * usual**2) / (len(squares) + SEEN)
    return max(float(np.sqrt(variance)), LEAST_SD)


def _kinds(y: Floats, precisions: Floats, mean: float, between: float) -> tuple[Floats, Floats]:
    """Return mean and variance of each kind's mean, given the rest. precisions : [kinds, n]"""
    precision = 1.0 / between**2 + precisions.sum(axis=1)
    centre = (mean / between**2 + precisions @ y) / precision
    return centre, 1.0 / precision
