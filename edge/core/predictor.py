"""The one seam of every predictor, `rollout(history, controls, ahead) -> T`, and the scored horizons."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

HORIZONS_MIN = (1, 5, 15, 30, 60)
STEPS_MAX = 100  # of the 120 rows of the history: a forecast that ends now must find where it began
_OFF_MAX = 0.1  # share of a horizon that whole steps may be off


def steps_of(step_s: float) -> dict[int, int]:
    """Control steps of each horizon that fits them, by the horizon in minutes, shortest first.

    A horizon is left out where no number of steps comes within a tenth of it, or where it needs more than
    STEPS_MAX: at steps of 10 s the longest is 15 minutes.
    """
    found = {}
    for minutes in HORIZONS_MIN:
        steps = round(60.0 * minutes / step_s)
        if 1 <= steps <= STEPS_MAX and abs(steps * step_s / (60.0 * minutes) - 1.0) <= _OFF_MAX:
            found[minutes] = steps
    return found


Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]


class Predictor(Protocol):
    """A model of the air temperature, stepped at `step_s`."""

    @property
    def name(self) -> str:
        """Kind of model: arx, physics, lstm, hybrid."""
        ...

    @property
    def version(self) -> str:
        """Which fit this is: file hash or fit date."""
        ...

    @property
    def step_s(self) -> float:
        """Time from one row to the next [s]."""
        ...

    @property
    def rows_needed(self) -> int:
        """Rows of history without which it can't start."""
        ...

    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        """Air temperature after each control.

        history : columns up to now; row i's inputs hold from its time to the next, so the last row's
            `heater_duty` and `fan_on` are not read
        controls : [B, N, 2], heater_duty and fan_on
        ahead : columns of length N for the coming steps (`temp_ambient`, ...); row 0 is now
        Returns : [B, N], T[:, k] one step after controls[:, k] [°C]
        """
        ...
