"""Time and samples of the board: milliseconds that wrap, raw integers with a quality and an age."""

from collections.abc import Mapping
from dataclasses import dataclass

from firmware_protocol.fields import Field
from firmware_protocol.messages import LAYOUTS, Quality, SensorReport, StateEcho

_MASK = 0xFFFFFFFF


def wrap(ms: int) -> int:
    """Return a time as the board's clock shows it."""
    return ms & _MASK


def elapsed_ms(now_ms: int, since_ms: int) -> int:
    """Time that passed [ms], right across a wrap; a clock that goes back shows as very much."""
    return (now_ms - since_ms) & _MASK


MAX_AGE_MS = 3000
AIR = "temp_air_c"
AIR_LOW, AIR_HIGH = -2000, 8000  # 0.01 °C: outside, the sensor is at fault
_RAW_LIMIT = 2**31 - 1  # a board holds a sample in 32 bits

_REPORTED = LAYOUTS[SensorReport].fields[1::2]  # board_ms, then value and quality in turn
_FAN_RPM = next(field for field in LAYOUTS[StateEcho].fields if field.name == "fan_rpm")
SIGNALS: Mapping[str, Field] = {field.name: field for field in (*_REPORTED, _FAN_RPM)}


@dataclass(slots=True)
class Sample:
    """The newest sample of one signal; `raw` is None when there is no number."""

    raw: int | None = None
    quality: Quality = Quality.ABSENT
    time_ms: int = 0

    @property
    def good(self) -> bool:
        """A number that may be used."""
        return self.quality is Quality.GOOD


def to_raw(signal: str, value: float | None) -> int | None:
    """Return the wire's integer for a sensor's value, in 32 bits but not
    yet checked; None for None and NaN.
    """
    if value is None or value != value:
        return None
    scaled = value * (SIGNALS[signal].per_unit or 1)
    return round(min(max(scaled, -_RAW_LIMIT), _RAW_LIMIT))


def judge(signal: str, raw: int | None, quality: int, now_ms: int) -> Sample:
    """Return the stored sample: good only for a number that its field and its sensor allow."""
    found = Quality.GOOD
    if raw is None:
        found = Quality.FAULT
    elif not SIGNALS[signal].low <= raw <= SIGNALS[signal].high or raw == SIGNALS[signal].none:
        raw, found = None, Quality.RANGE
    elif signal == AIR and not AIR_LOW <= raw <= AIR_HIGH:
        found = Quality.RANGE
    told = Quality(quality) if quality in tuple(Quality) else Quality.FAULT
    return Sample(raw, found if told is Quality.GOOD else told, now_ms)


class Samples:
    """The newest sample of every signal."""

    def __init__(self) -> None:
        self._samples = {signal: Sample() for signal in SIGNALS}

    def advance(self, now_ms: int) -> None:
        """Good samples older than MAX_AGE_MS become stale, and stay it when the clock wraps."""
        for sample in self._samples.values():
            if sample.good and elapsed_ms(now_ms, sample.time_ms) > MAX_AGE_MS:
                sample.quality = Quality.STALE

    def take(self, signal: str, value: float | None, quality: int, now_ms: int) -> Sample:
        """Keep a new sample and return it."""
        sample = judge(signal, to_raw(signal, value), quality, now_ms)
        self._samples[signal] = sample
        return sample

    def report(self, now_ms: int) -> SensorReport:
        """All of them as a message."""
        values: list[object] = []
        for field in _REPORTED:
            sample = self._samples[field.name]
            values += [None if sample.raw is None else field.from_raw(sample.raw), sample.quality]
        return SensorReport(now_ms, *values)  # type: ignore[arg-type]

    def fan_rpm(self) -> int | None:
        """Speed of the fan [1/min], None unless good."""
        sample = self._samples[_FAN_RPM.name]
        return sample.raw if sample.good else None
