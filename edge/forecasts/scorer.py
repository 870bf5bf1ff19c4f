"""Rollouts of a predictor as values, and forecasts against what came: from the state an hour ago, with
real inputs.

So a controller that changed its plan is no error of a model. A rollout over the longest horizon passes all
the shorter ones: one per predictor and tick scores every horizon.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from edge.core.horizons import steps_of
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


START_ROWS = 20  # temperatures up to a start that later measurements may since have corrected
INPUTS = ("heater_duty", "fan_on")
PERSISTENCE = "persistence"


@dataclass(frozen=True, slots=True)
class ScoredForecast:
    """One forecast that met its measurement."""

    predictor: str  # "persistence" is the measurement at the start, held
    version: str
    horizon_min: int
    residual_k: float  # measured minus forecast
    measured_c: float  # at the horizon's end


@dataclass(frozen=True, slots=True)
class _Start:
    measured_c: float  # NaN without a good reading: such a start is not scored
    temps: Floats  # the newest estimates as they stood then, at most START_ROWS [°C]


class Scorer:
    """The starts that wait for their measurements, a start per tick."""

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self._steps = steps_of(step_s)
        self._longest = max(self._steps.values(), default=0)
        self._starts: deque[_Start] = deque()
        self._last: tuple[float, ...] | None = None  # time and inputs of the newest row, as last seen
        self.skipped = 0  # starts that were never scored, since this one was made

    def observe(
        self, predictors: Mapping[str, Predictor], history: Columns, inputs_known: bool
    ) -> list[ScoredForecast]:
        """Score the forecasts that began `longest` steps ago, then begin new ones.

        predictors : by the name they are scored under
        history : `Estimator.history()` after the tick's inputs were recorded
        inputs_known : the board confirmed what it drives
        A missed tick, an input changed within its step or not confirmed: what was under way is skipped.
        """
        if not self._longest or not len(history["time_s"]):
            return []
        if self._last is None or not self._goes_on(history):
            self.drop()
        scored = []
        if len(self._starts) == self._longest:
            scored = self._score(predictors, history, self._starts.popleft())
        self._last = _newest(history, -1)
        if inputs_known and all(map(math.isfinite, self._last)):
            temps = history["temp_air"][-START_ROWS:].copy()
            self._starts.append(_Start(float(history["temp_air_measured"][-1]), temps))
        else:
            self.drop()
        return scored

    def _goes_on(self, history: Columns) -> bool:
        return len(history["time_s"]) > 1 and _newest(history, -2) == self._last

    def drop(self) -> None:
        """Skip the forecasts that are under way."""
        self.skipped += len(self._starts)
        self._starts.clear()

    def _score(
        self, predictors: Mapping[str, Predictor], history: Columns, start: _Start
    ) -> list[ScoredForecast]:
        at = len(history["time_s"]) - 1 - self._longest
        if at < 0 or not math.isfinite(start.measured_c):
            self.skipped += 1
            return []
        # What was known then: the filter's later corrections of these rows would flatter the forecast.
        past = {name: column[: at + 1] for name, column in history.items()}
        past["temp_air"] = past["temp_air"].copy()
        tail = start.temps[-(at + 1) :]
        past["temp_air"][len(past["temp_air"]) - len(tail) :] = tail
        controls = np.column_stack([history[name][at:-1] for name in INPUTS])
        measured = {m: float(history["temp_air_measured"][at + n]) for m, n in self._steps.items()}
        seen = {m: value for m, value in measured.items() if math.isfinite(value)}
        scored = [
            ScoredForecast(PERSISTENCE, "1", m, value - start.measured_c, value) for m, value in seen.items()
        ]
        for name, predictor in predictors.items():
            temps = roll(predictor, past, controls, self._step_s).temps
            if temps is not None:
                scored += [
                    ScoredForecast(
                        name, predictor.version, m, value - float(temps[self._steps[m] - 1]), value
                    )
                    for m, value in seen.items()
                ]
        return scored


def _newest(history: Columns, row: int) -> tuple[float, ...]:
    return tuple(float(history[name][row]) for name in ("time_s", *INPUTS))
