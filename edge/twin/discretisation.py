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
    """The step of `step_s` at each fan speed.

    fan : [K], share of the full flow that holds over the step
    """
    speeds = fan[:, None, None]
    state, integral = exponential(system.rates + speeds * system.fan_rates, step_s)
    return Transition(state, integral @ (system.drive + speeds * system.fan_drive))


def discretise_modes(system: LinearSystem, modes: Floats, step_s: float) -> Transition:
    """The same for K fan speeds, doors and days, [K, 3]."""
    fan, others = modes[:, 0, None, None], modes[:, 1:]
    rates = system.rates + fan * system.fan_rates + np.tensordot(others, system.other_rates, 1)
    drive = system.drive + fan * system.fan_drive + np.tensordot(others, system.other_drive, 1)
    state, integral = exponential(rates, step_s)
    return Transition(state, integral @ drive)


def exponential(rates: Floats, step_s: float) -> tuple[Floats, Floats]:
    """exp(A t) and its integral from 0 to t, for each A; NaN rates give NaN.

    rates : [K, n, n] [1/s]
    Returns : [K, n, n] each, the second in s
    """
    if rates.shape[-1] == 1:
        exponent = rates * step_s
        still = exponent == 0.0
        return np.exp(exponent), step_s * np.where(
            still, 1.0, np.expm1(exponent) / np.where(still, 1.0, exponent)
        )
    size = rates.shape[-1]
    block = np.zeros((len(rates), 2 * size, 2 * size))  # exp of [[A, 1], [0, 0]] t holds both (Van Loan 1978)
    block[:, :size, :size] = rates * step_s
    block[:, :size, size:] = step_s * np.eye(size)
    norm = np.abs(block).sum(axis=-1).max(initial=0.0)
    halvings = max(0, int(np.ceil(np.log2(norm / _TAYLOR_NORM)))) if np.isfinite(norm) and norm > 0.0 else 0
    result = _taylor(block / 2.0**halvings)
    for _ in range(halvings):
        result = result @ result
    return result[:, :size, :size], result[:, :size, size:]


def _taylor(matrices: Floats) -> Floats:
    """exp of matrices of a small norm, by Horner's scheme."""
    identity = np.eye(matrices.shape[-1])
    result = np.broadcast_to(identity, matrices.shape)
    for term in range(_TAYLOR_TERMS, 0, -1):
        result = identity + matrices @ result / term
    return result
