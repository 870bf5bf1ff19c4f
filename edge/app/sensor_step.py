"""The steps in which a sensor shows the air."""

import numpy as np
from numpy.typing import NDArray

STEPS_K = (
    1.0,
    0.5,
    0.25,
    0.2,
    0.125,
)  # of sensors there are, the coarsest first; finer ones are lost in noise
SHARE = 0.6  # of the readings that lie on the steps: a mean of samples is on them while the air is slow
SEEN_STEPS = 4.0  # over which the air must have moved


def step_of(air_c: NDArray[np.float64]) -> float:
    """Return the coarsest step that readings lie on, 0 for none [K]. air_c : [N], NaN where unknown

    The offset of a calibration does not hide it. Each reading is an angle on the step, and all of them point
    one way (Fisher, Statistical Analysis of Circular Data, 1993: the mean resultant length).
    """
    seen = air_c[np.isfinite(air_c)]
    moved_k = float(np.ptp(seen)) if len(seen) else 0.0
    return next((k for k in STEPS_K if moved_k >= SEEN_STEPS * k and _on_steps(seen, k) >= SHARE), 0.0)


def _on_steps(air_c: NDArray[np.float64], step_k: float) -> float:
    return float(abs(np.exp(2j * np.pi * air_c / step_k).mean()))
