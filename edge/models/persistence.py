"""The forecast that needs no data: it stays as it is. For rigs that run by rules, whatever their step."""

from dataclasses import dataclass

import numpy as np

from edge.core.predictor import Columns, Floats


@dataclass(frozen=True, slots=True)
class Persistence:
    """T[t+1] = T[t]; whatever the inputs do is left to the estimator's offset."""

    step_s: float
    name: str = "persistence"
    version: str = "1"
    rows_needed: int = 1

    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        """Return the newest air temperature, as
        `edge.core.predictor.Predictor.rollout`, shape [B, N] [°C].
        """
        batch, horizon, _ = controls.shape
        return np.full((batch, horizon), history["temp_air"][-1])
