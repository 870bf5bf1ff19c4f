"""A linear system over one step with constant inputs, exactly; for many speeds of the fan as well."""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from edge.twin.network import LinearSystem


def distinct(rows: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first index of each unique row and the inverse mapping [N]. rows : [N, K], K above 0"""
    packed = np.ascontiguousarray(rows).view(np.dtype((np.void, rows.itemsize * rows.shape[1])))
    _, first, which = np.unique(packed.ravel(), return_index=True, return_inverse=True)
    return first, which


Floats = NDArray[np.float64]
_TAYLOR_NORM = 0.5  # at this norm the remainder after _TAYLOR_TERMS is below 1e-17
_TAYLOR_TERMS = 14


@dataclass(frozen=True, slots=True, eq=False)
class Transition:
    """x+ = state x + drive (u_h, T_amb, r), for each of K fan speeds.

    state : [K, n, n]; drive : [K, n, 3], columns as `edge.twin.network.INPUTS`
    """

    state: Floats
    drive: Floats


def discretise(system: LinearSystem, fan: Floats, step_s: float) -> Transition:
    """Return the step of `step_s` at each fan speed.

    fan : [K], share of the full flow that holds over the step
    """
    speeds = fan[:, None, None]
    state, integral = exponential(system.rates + speeds * system.fan_rates, step_s)
    return Transition(state, integral @ (system.drive + speeds * system.fan_drive))


def discretise_modes(system: LinearSystem, modes: Floats, step_s: float) -> Transition:
    """Return the steps for K fan speeds, doors and days, [K, 3]."""
    fan, others = modes[:, 0, None, None], modes[:, 1:]
    rates = system.rates + fan * system.fan_rates + np.tensordot(others, system.other_rates, 1)
    drive = system.drive + fan * system.fan_drive + np.tensordot(others, system.other_drive, 1)
    state, integral = exponential(rates, step_s)
    return Transition(state, integral @ drive)


def exponential(rates: Floats, step_s: float | Floats) -> tuple[Floats, Floats]:
    """exp(A t) and its integral from 0 to t, for each A; NaN rates give NaN.

    rates : [..., n, n] [1/s]; step_s : one t, or one for each A, [..., 1, 1]
    Returns : [..., n, n] each, the second in s
    """
    if rates.shape[-1] == 1:
        exponent = rates * step_s
        still = exponent == 0.0
        return np.exp(exponent), step_s * np.where(
            still, 1.0, np.expm1(exponent) / np.where(still, 1.0, exponent)
        )
    # Scaling and squaring by hand (Moler & Van Loan 2003, SIAM Review 45(1)): SciPy stays out of the daemon's
    # memory, and the integral, doubled along, needs no inverse of rates that may be singular.
    scaled = rates * step_s
    norm = np.abs(scaled).sum(axis=-1).max(initial=0.0)
    halvings = max(0, int(np.ceil(np.log2(norm / _TAYLOR_NORM)))) if np.isfinite(norm) and norm > 0.0 else 0
    scaled /= 2.0**halvings
    mean = _mean_exponential(scaled)
    state = np.eye(rates.shape[-1]) + scaled @ mean
    integral = mean * (step_s / 2.0**halvings)
    for _ in range(halvings):
        integral = integral + state @ integral
        state = state @ state
    return state, integral


def _mean_exponential(matrices: Floats) -> Floats:
    """Return the mean of exp(A s) over s from 0 to 1, for matrices of a small norm, by Horner's scheme."""
    identity = np.eye(matrices.shape[-1])
    result = np.broadcast_to(identity, matrices.shape)
    for term in range(_TAYLOR_TERMS, 1, -1):
        result = identity + matrices @ result / term
    return result


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
