"""Kalman filter on the air temperature with the predictor in use, and the disturbance that predictor misses.

State: the newest `n` air temperatures and the offset, x = [T_k, T_k-1, .., offset], so that a model with lags
is filtered exactly when it is linear: T_k+1 = f(T_k, T_k-1, .., inputs) + offset, the offset a random walk.
An MPC that adds the offset to its predictor has no steady-state error (offset-free MPC: Pannocchia and
Rawlings, AIChE J. 49(2), 2003). Covariances follow the predictor's slope, taken by finite differences.
"""

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from edge.config.settings import EstimatorSettings
from edge.core.messages import Command, Estimate, Reading, ReadingQuality
from edge.core.names import SIGNALS
from edge.core.predictor import Columns, Floats, Predictor
from edge.tick.calibration import CalibrationChange
from edge.twin.filter import predict, symmetric, update

HISTORY_ROWS = 120
LAGS_MAX = 4  # older temperatures are taken as known
SLOPE_STEP_K = 0.01  # for finite differences
PERSISTENCE_SD_K = 0.5  # error of "as it is now" after a minute
OFFSET_START_SD_K = 0.1  # what a fresh model may miss per minute
CLIP_SD = 3.0  # an open door is no disturbance to learn: beyond this an innovation teaches the offset no more
_INPUTS = ("heater_duty", "fan_on")
_OTHERS = tuple(name for name in SIGNALS if name not in ("temp_air", "temp_ambient"))
COLUMNS = ("time_s", "utc", "temp_air", "temp_air_measured", "temp_ambient", *_INPUTS, *_OTHERS)


class Estimator:
    """History and filter state of one rig."""

    def __init__(
        self, settings: EstimatorSettings, model: Predictor, step_s: float, ambient_default: float
    ) -> None:
        """`ambient_default`: room temperature until a sensor tells one [°C]."""
        self._settings = settings
        self._model = model
        self._step_s = step_s
        self._minutes = step_s / 60.0
        self._ambient = ambient_default
        self._rows = {name: deque[float](maxlen=HISTORY_ROWS) for name in COLUMNS}
        self._offset = 0.0
        self._good_s = -math.inf
        self._lags = _lags(model)
        self._covariance = self._start_covariance()

    def update(self, readings: Mapping[str, Reading], now_s: float, utc: float) -> Estimate:
        """One tick: predict from the last one, correct by the measurement if there is a good one.

        Ticks that were missed are predicted too, without inputs: the board's lease had ended.
        """
        self._ambient = _good(readings, "temp_ambient", self._ambient)
        measured = _good(readings, "temp_air", math.nan)
        if math.isfinite(measured):
            self._good_s = readings["temp_air"].time_s
        innovation = None
        if self._advance(readings, now_s, utc):
            innovation = self._correct(measured)
        else:
            self._restart(measured, readings, now_s, utc)
        if self._rows["temp_air"]:
            self._rows["temp_air_measured"][-1] = measured
        return Estimate(
            temp_air=self._rows["temp_air"][-1] if self._rows["temp_air"] else math.nan,
            temp_air_sd=math.sqrt(self._covariance[0, 0]),
            offset=self._offset,
            innovation=innovation,
            temp_ambient=self._ambient,
            time_s=self._good_s,
        )

    def record_sent(self, command: Command) -> None:
        """Record the inputs that hold from the last row's time on: the board's outputs, as far as known."""
        if self._rows["heater_duty"]:
            self._rows["heater_duty"][-1] = command.heater_duty
            self._rows["fan_on"][-1] = command.fan

    def history(self) -> Columns:
        """Columns as `Context.history` of the controllers; the last row's inputs are NaN until recorded."""
        return {name: np.array(rows) for name, rows in self._rows.items()}

    def recalibrate(self, change: CalibrationChange) -> None:
        """Go on as if a sensor had always read by another calibration, so that no filter sees a jump."""
        columns = ("temp_air", "temp_air_measured") if change.signal == "temp_air" else (change.signal,)
        for name in columns:
            self._rows[name] = deque((change.convert(value) for value in self._rows[name]), HISTORY_ROWS)
        if change.signal == "temp_ambient":
            self._ambient = change.convert(self._ambient)

    def set_model(self, model: Predictor) -> None:
        """Go on with another predictor without a bump: its offset starts where both predict the same."""
        before, _ = self._predict()
        self._model = model
        kept = self._covariance[0, 0]
        self._lags = _lags(model)
        self._covariance = self._start_covariance()
        self._covariance[0, 0] = kept
        after, by_model = self._predict()
        self._offset = self._offset + before - after if by_model else 0.0

    def _advance(self, readings: Mapping[str, Reading], now_s: float, utc: float) -> bool:
        """Predict up to now, a row per step; False when there is nothing to predict from."""
        if not self._rows["time_s"]:
            return False
        steps = max(1, round((now_s - self._rows["time_s"][-1]) / self._step_s))
        if steps > HISTORY_ROWS:
            return False
        for left in range(steps - 1, -1, -1):
            ago_s = left * self._step_s
            self._append(self._step(), {} if left else readings, now_s - ago_s, utc - ago_s)
            if left:
                self.record_sent(Command())
        return True

    def _restart(self, measured: float, readings: Mapping[str, Reading], now_s: float, utc: float) -> None:
        """Forget the past; begin from the measurement if there is one."""
        for column in self._rows.values():
            column.clear()
        self._covariance = self._start_covariance()
        if math.isfinite(measured):
            self._append(measured, readings, now_s, utc)
        else:
            self._covariance[0, 0] = math.inf

    def _step(self) -> float:
        """Predict the temperature one step on, and the covariance there."""
        predicted, by_model = self._predict()
        size = self._lags + 1
        transition = np.zeros((size, size))
        transition[0, :-1], transition[0, -1] = self._slopes(by_model), float(by_model)
        transition[1:-1, : self._lags - 1] = np.eye(self._lags - 1)
        transition[-1, -1] = 1.0
        noise = np.zeros((size, size))
        error_sd = self._settings.process_sd_k if by_model else PERSISTENCE_SD_K
        noise[0, 0] = error_sd**2 * self._minutes
        noise[-1, -1] = (self._settings.offset_sd_k * self._minutes) ** 2 * self._minutes
        self._covariance = predict(self._covariance, transition, noise)
        return predicted

    def _predict(self) -> tuple[float, bool]:
        """Temperature one step on, and whether the model gave it; persistence while it can't [°C]."""
        history = self.history()
        if len(history["temp_air"]) < max(1, self._model.rows_needed):
            return (float(history["temp_air"][-1]) if len(history["temp_air"]) else math.nan), False
        predicted = self._rollout(history)
        if not math.isfinite(predicted):
            return float(history["temp_air"][-1]), False
        return predicted + self._offset, True

    def _rollout(self, history: Columns) -> float:
        inputs = [np.nan_to_num(history[name][-1:], nan=0.0) for name in _INPUTS]
        ahead = {name: column[-1:] for name, column in history.items()}
        return float(self._model.rollout(history, np.array([inputs]).reshape(1, 1, 2), ahead)[0, 0])

    def _slopes(self, by_model: bool) -> Floats:
        """How the prediction moves with each of the newest temperatures, shape [lags] [K/K]."""
        slopes = np.zeros(self._lags)
        if not by_model:
            slopes[0] = 1.0
            return slopes
        history = dict(self.history())
        base = self._rollout(history)
        for lag in range(min(self._lags, len(history["temp_air"]))):
            moved = history["temp_air"].copy()
            moved[-1 - lag] += SLOPE_STEP_K
            slopes[lag] = (self._rollout({**history, "temp_air": moved}) - base) / SLOPE_STEP_K
        return slopes

    def _correct(self, measured: float) -> float | None:
        """Update and return the innovation. None without a measurement, which
        leaves mean and covariance as predicted.
        """
        if not math.isfinite(measured):
            return None
        temps = self._rows["temp_air"]
        innovation = measured - temps[-1]
        known = min(self._lags, len(temps))
        mean = np.zeros(self._lags + 1)  # a young history has no older ones
        mean[:known] = [temps[-1 - lag] for lag in range(known)]
        mean[-1] = self._offset
        variance = self._settings.measurement_sd_k**2
        mean, covariance = update(mean, self._covariance, measured, variance, clip_sd=CLIP_SD)
        *newest, self._offset = mean.tolist()
        for lag in range(known):
            temps[-1 - lag] = newest[lag]
        self._covariance = symmetric(covariance)
        return innovation

    def _append(self, temp_air: float, readings: Mapping[str, Reading], now_s: float, utc: float) -> None:
        row = {"time_s": now_s, "utc": utc, "temp_air": temp_air, "temp_ambient": self._ambient}
        row |= {name: _good(readings, name, math.nan) for name in _OTHERS}
        for name, column in self._rows.items():
            column.append(row.get(name, math.nan))

    def _start_covariance(self) -> Floats:
        covariance = np.zeros((self._lags + 1, self._lags + 1))
        covariance[0, 0] = self._settings.measurement_sd_k**2
        covariance[-1, -1] = (OFFSET_START_SD_K * self._minutes) ** 2
        return covariance


def _lags(model: Predictor) -> int:
    return min(max(1, model.rows_needed), LAGS_MAX)


def _good(readings: Mapping[str, Reading], name: str, otherwise: float) -> float:
    reading = readings.get(name)
    if reading is None or reading.quality is not ReadingQuality.GOOD or reading.value is None:
        return otherwise
    return reading.value if math.isfinite(reading.value) else otherwise
