"""Exponentials of a twin's rates at many speeds of the fan, as one that spins up has."""

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from edge.twin.discretisation import exponential
from edge.twin.distinct import distinct

Floats = NDArray[np.float64]
MANY = 256  # exponentials of one kind of rates, beyond which they are interpolated
POINTS = 16  # in parts of 5 s the error is that of rounding while the fan changes the air within 1 s or more


def exponentials(rates: Floats, fan_rates: Floats, fan: Floats, lengths: Floats) -> tuple[Floats, Floats]:
    """exp(A t) and its integral, for S kinds of rows in J parts each, [J, S, n, n].

    rates : [S, n, n] with the fan at rest; fan_rates : [n, n], more at its full speed; fan : [J, S], 0..1
    lengths : [J] [s]
    """
    kinds, kind = distinct(rates.reshape(len(rates), -1))
    if fan.size <= MANY * len(kinds):
        return exponential(rates + fan[..., None, None] * fan_rates, lengths[:, None, None, None])
    state, integral = np.empty((2, *fan.shape, *fan_rates.shape))
    for i, own in enumerate(kinds):
        rows = kind == i
        state[:, rows], integral[:, rows] = _between(rates[own], fan_rates, fan[:, rows], lengths)
    return state, integral


def _between(rates: Floats, fan_rates: Floats, fan: Floats, lengths: Floats) -> tuple[Floats, Floats]:
    """By polynomials through Chebyshev's points. rates : [n, n]; fan : [J, S]"""
    points = chebyshev.chebpts1(POINTS)
    kinds, which = np.unique(lengths, return_inverse=True)
    at_points = rates + 0.5 * (1.0 + points)[:, None, None] * fan_rates
    both = np.stack(exponential(at_points, kinds[:, None, None, None]), axis=2)
    values = both.reshape(len(kinds), POINTS, -1)
    series = np.linalg.solve(chebyshev.chebvander(points, POINTS - 1), values)
    found = chebyshev.chebvander(2.0 * fan - 1.0, POINTS - 1) @ series[which]
    state, integral = np.moveaxis(found.reshape(*fan.shape, 2, *rates.shape), 2, 0)
    return state, integral
