"""The one seam of every predictor, `rollout(history, controls, ahead) -> T`."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

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
