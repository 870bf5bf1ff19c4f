"""A linear system over one step with constant inputs, exactly."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge.twin.network import LinearSystem

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
