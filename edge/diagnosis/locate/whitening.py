"""Effect of small disturbances on the filter's innovations, in standard deviations.

A filter is linear, so what heat, a wrong reading or a jump in a row would add to all later innovations is
known beforehand; how well that fits those seen tells how likely it was (Willsky & Jones 1976, IEEE TAC 21).
"""

import numpy as np
from numpy.typing import NDArray

from edge.diagnosis.locate.heat_filter import HeatFilterResult, Steps

Floats = NDArray[np.float64]
LAGS = 400  # rows after which a response is forgotten


def white(way: HeatFilterResult) -> Floats:
    """Innovations in standard deviations, [B, N]; 0 where nothing was measured."""
    return np.asarray(np.nan_to_num(way.innovation) / np.sqrt(way.variance)).T


def pulses(steps: Steps, way: HeatFilterResult) -> Floats:
    """Response to 1 W during step i alone, [B, N, J]: element j is that of the row after step i + j."""
    return _responses(steps, way, steps.matrix[..., -1])


def jumps(steps: Steps, way: HeatFilterResult) -> Floats:
    """Return the innovations for 1 W from step i on."""
    return _responses(steps, way, steps.matrix[..., -2])


def spikes(steps: Steps, way: HeatFilterResult) -> Floats:
    """Return the innovations if only the reading after step i is 1 K too high."""
    shown = _scale(way, np.ones_like(way.innovation), 0)
    later = -np.einsum("kbij,kbj->kbi", steps.matrix[1:], way.gain[:-1])
    rest = _responses(steps, way, np.concatenate([np.zeros_like(way.gain[:1]), later]))
    # In place, as a second array of this size is what a small machine lacks.
    for run in rest:
        run[:-1, 1:] = run[1:, :-1]
    rest[:, -1, 1:] = 0.0
    rest[:, :, 0] = shown.T
    return rest


def _responses(steps: Steps, way: HeatFilterResult, state: Floats) -> Floats:
    """state : [N, B, m], by how much the row's state after step i is off what the filter expects."""
    rows, count = way.innovation.shape
    lags = min(rows, LAGS)
    found = np.zeros((count, rows, lags))
    for lag in range(lags):
        reach = rows - lag
        state = state[:reach]
        found[:, :reach, lag] = _scale(way, state[..., 0], lag).T
        state = state - way.gain[lag:] * state[..., :1]
        if reach > 1:
            state = np.einsum("kbij,kbj->kbi", steps.matrix[lag + 1 :], state[:-1])
    return found


def _scale(way: HeatFilterResult, shown: Floats, lag: int) -> Floats:
    measured = np.isfinite(way.innovation[lag:])
    return np.where(measured, shown / np.sqrt(way.variance[lag:]), 0.0)


def score(response: Floats, innovations: Floats) -> Floats:
    """Sum over later rows of response times innovation, [N].

    response : [N, J] of one run; innovations : [N], white
    """
    lags = response.shape[1]
    later = np.lib.stride_tricks.sliding_window_view(np.pad(innovations, (0, lags - 1)), lags)
    return np.asarray(np.einsum("nj,nj->n", response, later))


def response_to(response: Floats, amounts: Floats) -> Floats:
    """White innovations that these amounts in each step would cause; amounts : [N, p]. Returns : [N, p]"""
    total = np.zeros_like(amounts)
    for lag in range(response.shape[1]):
        reach = len(amounts) - lag
        total[lag:] += response[:reach, lag, None] * amounts[:reach]
    return total
