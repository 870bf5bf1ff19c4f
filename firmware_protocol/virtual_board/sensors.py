"""Sensors of the chamber: lag, bias, noise, quantisation, and lasting faults."""

import math
from collections.abc import Mapping

from firmware_protocol.messages import Quality
from firmware_protocol.virtual_board.chamber_parameters import ChamberParameters
from firmware_protocol.virtual_board.effects import Effects
from firmware_protocol.virtual_board.faults import BoardFault
from firmware_protocol.virtual_board.noise import normal

Sample = tuple[float | None, int]

_GOOD, _FAULT = int(Quality.GOOD), int(Quality.FAULT)


class SensorFaults:
    """Remembers what each sensor showed last, for a stuck one."""

    def __init__(self) -> None:
        self._shown: dict[str, Sample] = {}
        self._active: list[BoardFault] = []

    def set_faults(self, active: list[BoardFault]) -> None:
        """From now on these last."""
        self._active = [fault for fault in active if "signal" in fault.parameters]

    def spoil(self, sensed: Mapping[str, float]) -> dict[str, Sample]:
        """Return samples for the board: signal -> (value, quality)."""
        samples: dict[str, Sample] = {signal: (value, _GOOD) for signal, value in sensed.items()}
        for fault in self._active:
            signal = str(fault.parameters["signal"])
            if signal in samples:
                samples[signal] = self._spoilt(signal, samples[signal], fault)
        self._shown = samples
        return samples

    def _spoilt(self, signal: str, sample: Sample, fault: BoardFault) -> Sample:
        value, quality = sample
        match fault.name:
            case "sensor_none":
                return None, _FAULT
            case "sensor_nan":
                return math.nan, _GOOD
            case "sensor_value":
                return fault.number("value"), quality
            case "sensor_stuck":
                return self._shown.get(signal, sample)
            case "sensor_offset" if value is not None:
                return value + fault.number("offset"), quality
            case "sensor_spike" if value is not None and fault.random.random() < fault.number("rate"):
                return value + fault.number("size"), quality
        return sample


_STREAM = 100
_SMALLEST_STEP = 1e-6


class Sensors:
    """Lagged values inside the sensors; `read` adds bias, noise and steps."""

    def __init__(self, parameters: ChamberParameters, effects: Effects, seed: int) -> None:
        self._p, self._e, self._seed = parameters.sensors, effects, seed
        self._air_lag_s = effects.sensor_lag * parameters.sensors.air_lag_s
        self._humidity_lag_s = effects.sensor_lag * parameters.sensors.humidity_lag_s
        self._co2_lag_s = effects.sensor_lag * parameters.sensors.co2_lag_s
        self.air_c = self.humidity_pct = self.co2_ppm = 0.0

    def start(self, air_c: float, humidity_pct: float, co2_ppm: float) -> None:
        """Sensors that have long been in this air."""
        self.air_c, self.humidity_pct, self.co2_ppm = air_c, humidity_pct, co2_ppm

    def step(self, dt_s: float, air_c: float, humidity_pct: float, co2_ppm: float, radiated_w: float) -> None:
        """Follow the mean values of a step; the air's sensor also sees the heater, if so switched."""
        air_c += self._e.sensor_radiation * self._p.radiation_k_w * radiated_w
        self.air_c += _follow(dt_s, self._air_lag_s) * (air_c - self.air_c)
        self.humidity_pct += _follow(dt_s, self._humidity_lag_s) * (humidity_pct - self.humidity_pct)
        self.co2_ppm += _follow(dt_s, self._co2_lag_s) * (co2_ppm - self.co2_ppm)

    def read(
        self, time_s: float, ambient_c: float, light: float, soil: float, tank: float
    ) -> dict[str, float]:
        """Values as shown now, in the units and under the names of `sensor_report`."""
        p, e = self._p, self._e
        day = time_s / 86400.0
        bias = e.sensor_bias * p.air_bias_k + e.sensor_drift * p.air_drift_k_day * day
        noise = self._noise(int(time_s / p.period_s))
        step_k, step_pct = p.temp_step_k * e.sensor_step, p.humidity_step_pct * e.sensor_step
        humidity = self.humidity_pct + e.sensor_bias * p.humidity_bias_pct + noise[1] * p.humidity_noise_pct
        return {
            "temp_air_c": _round(self.air_c + bias + noise[0] * p.air_noise_k, step_k),
            "rel_humidity_pct": min(max(_round(humidity, step_pct), 0.0), 100.0),
            "co2_ppm": min(
                max(_round(self.co2_ppm + noise[2] * p.co2_noise_ppm, e.sensor_step), 0.0), 10000.0
            ),
            "light": _unit(light + noise[3] * p.light_noise * (light > 0.0)),
            "soil_moisture": _unit(soil + noise[4] * p.soil_noise),
            "tank_level": _unit(tank + noise[5] * p.tank_noise),
            "temp_ambient_c": _round(
                ambient_c + e.ambient_offset * p.ambient_offset_k + noise[6] * p.ambient_noise_k, step_k
            ),
        }

    def _noise(self, conversion: int) -> list[float]:
        """One number per sensor; the same conversion always shows the same."""
        return [self._e.sensor_noise * normal(self._seed, _STREAM + k, conversion) for k in range(7)]


def _follow(dt_s: float, lag_s: float) -> float:
    return -math.expm1(-dt_s / lag_s) if lag_s > 0.0 else 1.0


def _round(value: float, step: float) -> float:
    return round(round(value / step) * step, 6) if step > _SMALLEST_STEP else value


def _unit(value: float) -> float:
    return min(max(value, 0.0), 1.0)
