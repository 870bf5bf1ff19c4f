"""Autoregressive model with exogenous inputs (paper, eq. method-arx-equation), ambient as an input.

The fan enters as the paper has it (on or off), or as what it does: a fan that changes air takes heat in
proportion to the excess of the air over the room, F rho c (T - T_ambient) (paper, eq. of the PBM). With the
excess as its input one coefficient holds at every temperature, and the model stays linear in the inputs at a
known temperature, which is all that exact planning asks for.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]
FanInput = Literal["on", "excess"]


@dataclass(frozen=True, slots=True, eq=False)
class Arx:
    """T[t+1] = sum a_i T[t+1-i] + sum b_j u[t+1-j] + c T_ambient[t] + d, for one step of `step_s`.

    temp : a_1..a_p, on the present and past air temperatures, shape [p]
    heater : b_1..b_q, on the present and past heater duties, shape [q] [K]
    fan : the same for the fan [K]; with `fan_input` "excess" on fan_on (T - T_ambient) [K/K]
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
    fan_input: FanInput = "on"

    @property
    def rows_needed(self) -> int:
        """Rows of history to start from, the last of them now."""
        return max(len(self.temp), len(self.heater))

    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        """Air temperature after each control, as `edge.core.predictor.Predictor.rollout`.

        history : `temp_air` and, as far as `rows_needed` reaches back, `heater_duty` and `fan_on`, and
            `temp_ambient` where the fan enters by the excess
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
        heater = _with_past(history["heater_duty"], controls[:, :, 0], lags)
        fan = _with_past(self._past_fan(history), controls[:, :, 1], lags)
        # All that does not depend on the temperature is summed before the loop, which alone is serial.
        driven = self._drift(ahead, horizon) + np.zeros((batch, 1))
        for lag in range(lags):
            driven += self.heater[lag] * heater[:, lags - 1 - lag : lags - 1 - lag + horizon]
        temps = np.empty((batch, order + horizon))
        temps[:, :order] = history["temp_air"][rows - order :]
        oldest_first_temp, oldest_first_fan = self.temp[::-1], self.fan[::-1]
        for k in range(horizon):
            if self.fan_input == "excess":
                fan[:, lags - 1 + k] *= temps[:, order + k - 1] - ahead["temp_ambient"][k]
            temps[:, order + k] = (
                temps[:, k : k + order] @ oldest_first_temp
                + fan[:, k : k + lags] @ oldest_first_fan
                + driven[:, k]
            )
        return temps[:, order:]

    def duty_to_hold(self, temp_air: float, temp_ambient: float, offset: float) -> float:
        """Heater duty 0..1 that holds an air temperature best with the fan off.

        temp_air, temp_ambient : [°C]; offset : as in `rollout` [K/step]
        """
        lacking = temp_air * (1.0 - self.temp.sum()) - self.ambient * temp_ambient - self.intercept - offset
        gain = self.heater.sum()
        return float(min(max(lacking / gain, 0.0), 1.0)) if gain > 0.0 else 0.0

    def responses(self, steps: int) -> tuple[Floats, Floats]:
        """Return what one step of full heat, and one of the fan, adds to the
        air temperature of each step [steps].

        [K]; the fan's per kelvin of excess [K/K] where it enters by that.
        """
        return self._response(self.heater, steps), self._response(self.fan, steps)

    def _response(self, inputs: Floats, steps: int) -> Floats:
        order = len(self.temp)
        added = np.zeros(order + steps)
        for k in range(steps):
            driven = inputs[k] if k < len(inputs) else 0.0
            added[order + k] = added[k : k + order] @ self.temp[::-1] + driven
        return added[order:]

    def _drift(self, ahead: Columns, horizon: int) -> Floats:
        """Return the air temperature at each step without any input [horizon]."""
        drift = np.full(horizon, self.intercept)
        if self.ambient != 0.0:
            drift = drift + self.ambient * ahead["temp_ambient"][:horizon]
        if "offset" in ahead:
            drift = drift + ahead["offset"][:horizon]
        return drift

    def _past_fan(self, history: Columns) -> Floats:
        if self.fan_input == "on" or len(self.fan) == 1:
            return history["fan_on"]
        return history["fan_on"] * (history["temp_air"] - history["temp_ambient"])


def _with_past(column: Floats, ahead: Floats, lags: int) -> Floats:
    """Return the last `lags` - 1 decided inputs (the last row's is not
    decided yet), then `ahead`, [B, ..].
    """
    past = column[len(column) - lags : len(column) - 1]
    return np.concatenate([np.broadcast_to(past, (len(ahead), lags - 1)), ahead], axis=1)
