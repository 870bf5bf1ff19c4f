"""Rows of numbers that are the same, bit for bit."""

import numpy as np
from numpy.typing import NDArray


def distinct(rows: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first index of each unique row and the inverse mapping [N]. rows : [N, K], K above 0"""
    packed = np.ascontiguousarray(rows).view(np.dtype((np.void, rows.itemsize * rows.shape[1])))
    _, first, which = np.unique(packed.ravel(), return_index=True, return_inverse=True)
    return first, which
