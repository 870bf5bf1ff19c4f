"""Exact steps of a linear system, from its modes."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SMALL = 1e-3  # below, a series is more exact than the quotient
BLOCK = 200  # columns at once: numpy's library would share a larger product among threads, and wait for them


class Modes:
    """Eigenvalues and eigenvectors of slopes A [n, n] of dx/dt = A x + rest."""

    def __init__(self, slopes: Floats) -> None:
        self._slopes = slopes
        self._rates, self._shapes = np.linalg.eig(slopes)
        self._back = np.linalg.inv(self._shapes)

    def matrices(self, dt_s: float) -> Floats:
        """Return [3 n, n] of a step of ETD2RK by its two slopes f(x), f(ahead):

        ahead = x + M[:n] f(x), and x + M[n:2n] f(x) + M[2n:] f(ahead) after the step.
        """
        z = dt_s * self._rates
        near = np.abs(z) < SMALL
        safe = np.where(near, 1.0, z)
        first = np.where(near, 1.0 + z / 2.0 + z * z / 6.0, np.expm1(safe) / safe)
        second = np.where(near, 0.5 + z / 6.0 + z * z / 24.0, (first - 1.0) / safe)
        ahead, late = (dt_s * ((self._shapes * factor) @ self._back).real for factor in (first, second))
        return np.concatenate((ahead, ahead - late - late @ self._slopes @ ahead, late))


def product(matrix: Floats, columns: Floats) -> Floats:
    """Return matrix [n, m] @ columns [m, M], in one thread."""
    count = columns.shape[1]
    if count <= BLOCK:
        return np.asarray(matrix @ columns)
    found = np.empty((len(matrix), count))
    for k in range(0, count, BLOCK):
        found[:, k : k + BLOCK] = matrix @ columns[:, k : k + BLOCK]
    return found
