"""Lasting faults of the sensors."""

import math
from collections.abc import Mapping

from firmware_protocol.messages import Quality
from firmware_protocol.virtual_board.faults import BoardFault

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
