"""A predictor that can be reckoned by hand, and a rig whose history grows tick by tick."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

STEP_S = 60.0


@dataclass
class RampPredictor:
    """Each step adds `gain_k` times the duty, and `drift_k`."""

    gain_k: float = 1.0
    drift_k: float = 0.0
    name: str = "ramp"
    version: str = "1"
    step_s: float = STEP_S
    rows_needed: int = 1
    calls: list[Any] = field(default_factory=list)

    def rollout(self, history, controls, ahead):
        self.calls.append((history, controls, ahead))
        return history["temp_air"][-1] + np.cumsum(self.gain_k * controls[:, :, 0] + self.drift_k, axis=1)


class BrokenForecast(RampPredictor):
    """Returns `answer`, or raises it."""

    def __init__(self, answer, **changes):
        super().__init__(**changes)
        self.answer = answer

    def rollout(self, history, controls, ahead):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def columns(temps, duties=None, measured=None, fan=None, start_s=0.0, step_s=STEP_S):
    """A history as the estimator's: one row per temperature."""
    rows = len(temps)
    temps = np.asarray(temps, dtype=float)
    return {
        "time_s": start_s + step_s * np.arange(rows),
        "utc": 1.7e9 + start_s + step_s * np.arange(rows),
        "temp_air": temps,
        "temp_air_measured": temps.copy() if measured is None else np.asarray(measured, dtype=float),
        "temp_ambient": np.full(rows, 21.0),
        "heater_duty": np.zeros(rows) if duties is None else np.asarray(duties, dtype=float),
        "fan_on": np.zeros(rows) if fan is None else np.asarray(fan, dtype=float),
        "light": np.full(rows, np.nan),
    }


def window(history, ticks, rows=120):
    """Return the estimator's newest `rows` after so many ticks."""
    return {name: column[max(0, ticks - rows) : ticks].copy() for name, column in history.items()}
