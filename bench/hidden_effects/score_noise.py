"""Noise of free runs of the true equations: white noise and noise that is correlated in time.

The covariance between rows i and j of a run is w^2 [i = j] + a^2 phi^|i - j|: the sensor, and heat that
nobody recorded on its way through the box. A scalar Kalman filter takes it apart in order N (Anderson & Moore
1979, Optimal Filtering, ch. 5); a missing row is left out.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
LEAST_SD_K = 1e-3
_LONGEST_ROWS = 500.0  # a correlation beyond this is an offset, which would take the place of effects
_LEAST_SHARE, _START_ROWS = 0.3, (3.0, 60.0)  # of a start
_MOST_EVALUATIONS = 80


class ReadingNoise(NamedTuple):
    """white_k : w; wandering_k : a [K]; rows : over which the wandering falls to 1/e, -1 / log(phi)."""

    white_k: float
    wandering_k: float
    rows: float

    @property
    def phi(self) -> float:
        """From one row to the next."""
        return float(np.exp(-1.0 / self.rows))


class Whitener(NamedTuple):
    """The filter of B runs of N rows. gain, scale : [B, N]; scale is 1 / sd of an innovation, 0: missing."""

    phi: float
    gain: Floats
    scale: Floats
    log_det: float

    def __call__(self, columns: Floats) -> Floats:
        """Columns [B, m, N] as innovations in standard deviations, 0 where a row is missing."""
        in_time = np.ascontiguousarray(np.moveaxis(columns, 2, 0))
        innovations = np.empty_like(in_time)
        state = np.zeros(in_time.shape[1:])
        for k, now in enumerate(in_time):
            innovation = now - state
            innovations[k] = innovation * self.scale[:, k, None]
            state = self.phi * (state + self.gain[:, k, None] * innovation)
        return np.moveaxis(innovations, 0, 2)


def whitener(noise: ReadingNoise, measured: NDArray[np.bool_]) -> Whitener:
    """Return the filter for runs with these rows measured, [B, N]."""
    phi, gain, variance = noise.phi, np.zeros(measured.shape), np.ones(measured.shape)
    known = np.full(len(measured), noise.wandering_k**2)  # variance of the wandering before each row
    for k in range(measured.shape[1]):
        variance[:, k] = known + noise.white_k**2
        gain[:, k] = np.where(measured[:, k], known / variance[:, k], 0.0)
        left = known * (1.0 - gain[:, k])
        known = phi**2 * left + (1.0 - phi**2) * noise.wandering_k**2
    scale = np.where(measured, 1.0 / np.sqrt(variance), 0.0)
    return Whitener(phi, gain, scale, float(np.log(variance[measured]).sum()))


def log_likelihood(
    noise: ReadingNoise, residual: Floats, response: Floats, measured: NDArray[np.bool_]
) -> float:
    """Return the log likelihood of the residuals [B, N], with q unknowns of
    every run integrated out; without the constant.

    response : [B, q, N], what one standard deviation of each unknown does: states at the start, mains
    """
    whiten = whitener(noise, measured)
    white = whiten(np.concatenate([residual[:, None], response], axis=1))
    own, moved = white[:, 0], white[:, 1:]
    normal = moved @ moved.swapaxes(1, 2) + np.eye(moved.shape[1])
    slope = np.einsum("bqn,bn->bq", moved, own)
    explained = np.einsum("bq,bq->", slope, np.linalg.solve(normal, slope[..., None])[..., 0])
    spread = whiten.log_det + float(np.linalg.slogdet(normal)[1].sum())
    return -0.5 * float((own**2).sum() - explained + spread)


def likeliest(
    start: ReadingNoise, residual: Floats, response: Floats, measured: NDArray[np.bool_]
) -> ReadingNoise:
    """Find the noise under which the residuals are likeliest, by the simplex of Nelder & Mead from `start`.

    From a start that hardly wanders, or over hardly any rows, no small step leads away: it is moved first.
    """
    from scipy.optimize import minimize

    def noise(logs: Floats) -> ReadingNoise:
        white, wandering, rows = np.exp(np.clip(logs, -20.0, 20.0))
        return ReadingNoise(
            max(float(white), LEAST_SD_K),
            max(float(wandering), LEAST_SD_K),
            float(np.clip(rows, 0.2, _LONGEST_ROWS)),
        )

    # Logarithms: all three are positive, and differ by powers of ten.
    white, wandering, rows = start
    begun = np.log([white, max(wandering, _LEAST_SHARE * white), np.clip(rows, *_START_ROWS)])
    found = minimize(
        lambda logs: -log_likelihood(noise(logs), residual, response, measured),
        begun,
        method="Nelder-Mead",
        options={"maxfev": _MOST_EVALUATIONS, "fatol": 0.02, "xatol": 0.02},
    )
    return noise(found.x)
