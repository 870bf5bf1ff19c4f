"""Linear autoregressive model with exogenous inputs (paper, eq. method-arx-equation), ambient as an input."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge.errors import DataError

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]


@dataclass(frozen=True, slots=True, eq=False)
class Arx:
    """T[t+1] = sum a_i T[t+1-i] + sum b_j u[t+1-j] + c T_ambient[t] + d, for one step of `step_s`.

    temp : a_1..a_p, on the present and past air temperatures, shape [p]
    heater, fan : b_1..b_q, on the present and past inputs, shape [q] [K]
    ambient : c; 0 for a model without the ambient temperature
    intercept : d [K]
    validity : lowest and highest value of each column in the data of the fit
    """

    temp: Floats
    heater: Floats
    fan: Floats
    ambient: float
    intercept: float
    step_s: float
    version: str = "unsaved"
    name: str = "arx"
    validity: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def rows_needed(self) -> int:
        """Rows of history to start from, the last of them now."""
        return max(len(self.temp), len(self.heater))

    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        """Air temperature after each control, as `edge.models.base.Predictor.rollout`.

        history : `temp_air` and, as far as `rows_needed` reaches back, `heater_duty` and `fan_on`
        controls : [B, N, 2], heater_duty and fan_on
        ahead : `temp_ambient` [N] where the model has the ambient as an input [°C], and optionally
            `offset` [N], what the model misses per step [K/step]
        Returns : [B, N] [°C]
        Raises : DataError when the history is too short
        """
        batch, horizon, _ = controls.shape
        order, lags = len(self.temp), len(self.heater)
        rows = len(history["temp_air"])
        if rows < self.rows_needed:
            raise DataError(f"history: {rows} rows, the ARX model needs {self.rows_needed}")
        drift = np.full(horizon, self.intercept)
        if self.ambient != 0.0:
            drift = drift + self.ambient * ahead["temp_ambient"][:horizon]
        if "offset" in ahead:
            drift = drift + ahead["offset"][:horizon]
        inputs = self._inputs(history, controls)
        temps = np.empty((batch, order + horizon))
        temps[:, :order] = history["temp_air"][rows - order :]
        newest_first = self.temp[::-1]
        driven = np.zeros((batch, horizon)) + drift
        for lag in range(lags):
            window = inputs[:, lags - 1 - lag : lags - 1 - lag + horizon]
            driven += self.heater[lag] * window[:, :, 0] + self.fan[lag] * window[:, :, 1]
        for k in range(horizon):
            temps[:, order + k] = temps[:, k : k + order] @ newest_first + driven[:, k]
        return temps[:, order:]

    def _inputs(self, history: Columns, controls: Floats) -> Floats:
        """Past inputs (the last history row's are not decided yet) followed by `controls`, [B, q-1+N, 2]."""
        past_rows = len(self.heater) - 1
        rows = len(history["temp_air"])
        past = np.empty((len(controls), past_rows, 2))
        if past_rows:
            past[:, :, 0] = history["heater_duty"][rows - 1 - past_rows : rows - 1]
            past[:, :, 1] = history["fan_on"][rows - 1 - past_rows : rows - 1]
        return np.concatenate([past, controls], axis=1)
