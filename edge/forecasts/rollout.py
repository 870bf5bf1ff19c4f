"""A predictor's rollout as a value: temperatures, or why there are none. A model is a guest in the loop."""

from dataclasses import dataclass

import numpy as np

from edge.core.predictor import Columns, Floats, Predictor

STEP_TOLERANCE = 1e-6  # share of a step


@dataclass(frozen=True, slots=True)
class RolledForecast:
    """Air temperature after each step [°C]; None and the reason when the predictor has none."""

    temps: Floats | None
    reason: str = ""


def roll(predictor: Predictor, history: Columns, controls: Floats, step_s: float) -> RolledForecast:
    """One rollout under the inputs `controls`, shape [N, 2]. Never raises.

    history : columns up to the start, as `edge.core.predictor.Predictor.rollout`
    step_s : period of both [s]
    """
    if abs(predictor.step_s / step_s - 1.0) > STEP_TOLERANCE:
        return RolledForecast(None, f"made for steps of {predictor.step_s:g} s")
    rows = len(history["temp_air"])
    if rows < predictor.rows_needed:
        return RolledForecast(None, f"{rows} of {predictor.rows_needed} rows of history")
    try:
        rolled = predictor.rollout(history, controls[None], ahead_of(history, len(controls), step_s))
        temps = np.asarray(rolled, dtype=np.float64)
    except Exception as error:  # the other predictors and the loop go on
        return RolledForecast(None, f"{type(error).__name__}: {error}")
    if temps.shape != (1, len(controls)):
        return RolledForecast(None, f"shape {temps.shape}, not {(1, len(controls))}")
    if not np.isfinite(temps).all():
        return RolledForecast(None, f"not a number after step {int(np.argmin(np.isfinite(temps[0]))) + 1}")
    return RolledForecast(temps[0])


def ahead_of(history: Columns, steps: int, step_s: float) -> dict[str, Floats]:
    """Return the columns of the coming steps: measured values hold, time goes on; row 0 is now.

    No offset: that is what the estimator's own model misses, and here models are compared by themselves.
    """
    since_s = step_s * np.arange(steps)
    ahead = {}
    for name, column in history.items():
        if name not in ("temp_air", "temp_air_measured", "heater_duty", "fan_on"):
            ahead[name] = column[-1] + (since_s if name in ("time_s", "utc") else np.zeros(steps))
    return ahead
