"""Calibrations by a person at the rig: raw readings beside true values, and gain and offset of them.

A point is of raw readings, so that a second calibration takes the first one's place and never stacks on it.
"""

import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, NoReturn

from edge.config.settings import CalibrationSettings, SensorCalibration
from edge.core.errors import RequestError
from edge.core.messages import Reading, ReadingQuality
from edge.core.names import SIGNALS
from edge.formats.cross_check import CheckedDocument, Rule, SettingError
from edge.formats.reader import read_number

WINDOW_S = 60.0  # of a point: a thermometer in still air needs minutes, which shorter ones would not show
SPAN_S = 0.8 * WINDOW_S  # so far back the good samples must reach
LEAST_SHARE = 0.5  # of the samples of that time: a busy line loses some
APART_NOISES = 20.0  # noise of two points this far apart moves the gain by 7 % at most
POINTS_MAX = 2

Named = Annotated[str, Rule(choices=tuple(SIGNALS))]
Amount = Annotated[float, Rule(low=-1e5, high=1e5)]  # of any signal
Utc = Annotated[float, Rule(low=0.0, high=1e11)]


@dataclass(frozen=True, slots=True)
class PointLimits:
    """Bounds of points, in the unit of the signal.

    moves : largest noise, and largest move within WINDOW_S
    off : largest difference of the true value from the reading; a wrong unit is far beyond
    apart : least difference of two readings
    digits : after the point, in texts
    """

    moves: float
    off: float
    apart: float
    digits: int


LIMITS = {  # by unit
    "°C": PointLimits(0.15, 5.0, 5.0, 2),
    "%": PointLimits(1.5, 20.0, 20.0, 1),
    "ppm": PointLimits(40.0, 500.0, 300.0, 0),
    "1": PointLimits(0.02, 0.5, 0.1, 3),
}


@dataclass(frozen=True, slots=True)
class CalibrationPoint:
    """A known state of a sensor: the mean of its raw readings, their standard deviation, the true value."""

    signal: Named
    true_value: Amount
    raw: Amount
    noise: Annotated[float, Rule(low=0.0, high=1e5)]
    utc: Utc


@dataclass(frozen=True, slots=True)
class StandingCalibration(CheckedDocument):
    """A calibration that holds instead of the configured one of its signal."""

    signal: Named
    gain: Amount
    offset: Amount
    utc: Utc  # since when

    def cross_check(self) -> None:
        """Refuse what no configuration may say either."""
        in_force(CalibrationSettings(), (self,))


@dataclass(frozen=True, slots=True)
class RawMinute:
    """The raw samples of a signal within WINDOW_S.

    samples : oldest first, good or not
    reading : the present raw reading
    period_s : between two samples
    """

    samples: Sequence[Reading]
    reading: Reading
    now_s: float
    period_s: float

    def mean(self) -> tuple[float, float]:
        """Return mean and standard deviation. Errors: RequestError unless they are of one steady state"""
        signal = self.reading.signal
        if self.reading.quality is not ReadingQuality.GOOD:
            raise RequestError(f"{signal}: its readings are not good ({self.reading.quality.value})")
        recent = [sample for sample in self.samples if self.now_s - sample.time_s < WINDOW_S]
        good = [each for each in recent if each.value is not None and _is_good(each)]
        span_s = self.now_s - good[0].time_s if good else 0.0
        if span_s < SPAN_S or len(good) < LEAST_SHARE * WINDOW_S / self.period_s:
            raise RequestError(
                f"{signal}: {len(good)} good readings in the last {span_s:.0f} s are too few: "
                f"wait until there are readings of {WINDOW_S:g} s"
            )
        values = [each.value for each in good if each.value is not None]
        noise, third = statistics.stdev(values), len(values) // 3
        moved = statistics.fmean(values[-third:]) - statistics.fmean(values[:third])
        if not max(noise, abs(moved)) <= _limits(signal).moves:
            raise RequestError(
                f"{signal}: the readings are unsteady: they moved by {amount(signal, moved, '+')} "
                f"within {WINDOW_S:g} s, noise {amount(signal, noise)}; "
                f"at most {amount(signal, _limits(signal).moves)}. Wait until the sensor has settled"
            )
        return statistics.fmean(values), noise


@dataclass(frozen=True, slots=True)
class SensorDesk:
    """The facts that orders about calibrations are checked against.

    minute : by signal
    is_heating : the board drives the heater, or does not say
    """

    configured: CalibrationSettings
    minute: Callable[[str], RawMinute]
    temp_air_max_c: float
    is_heating: bool


@dataclass(frozen=True, slots=True)
class CalibrationState:
    """A signal's calibration as the status shows it.

    utc : since when a person's calibration holds, None: the configured one does
    following : what `apply_calibration` would bring, None without a point
    raw : present raw reading, None unless good
    """

    signal: str
    present: SensorCalibration
    utc: float | None
    points: tuple[CalibrationPoint, ...]
    following: SensorCalibration | None
    raw: float | None


@dataclass(frozen=True, slots=True)
class CalibrationChange:
    """Another calibration of a signal, and its last raw reading, None where there was none yet."""

    signal: str
    before: SensorCalibration
    after: SensorCalibration
    raw: float | None

    @property
    def jump(self) -> float:
        """The difference that it makes to the present reading."""
        return (
            0.0
            if self.raw is None
            else measurement(self.after, self.raw) - measurement(self.before, self.raw)
        )

    def convert(self, value: float) -> float:
        """Return an earlier measurement as it would have been under the new calibration."""
        return measurement(self.after, (value - self.before.offset) / self.before.gain)

    def in_words(self) -> str:
        """Say it with the figures of both."""
        reads = ""
        if self.raw is not None:
            now, then = (
                amount(self.signal, measurement(each, self.raw)) for each in (self.before, self.after)
            )
            reads = f": the sensor read {now} and reads {then}"
        signal = self.signal
        return f"{signal} is now {formula(signal, self.after)}, was {formula(signal, self.before)}{reads}"


def measurement(calibration: SensorCalibration, raw: float) -> float:
    """Return the measurement of a raw reading."""
    return calibration.gain * raw + calibration.offset


def formula(signal: str, calibration: SensorCalibration) -> str:
    """Return `1.02 * reading - 0.35 °C`."""
    sign = "-" if calibration.offset < 0.0 else "+"
    return f"{calibration.gain:.4g} * reading {sign} {amount(signal, abs(calibration.offset))}"


def amount(signal: str, value: float, sign: str = "") -> str:
    """Return a value with the unit of its signal."""
    unit = SIGNALS[signal].unit
    return f"{value:{sign}.{LIMITS[unit].digits}f}{'' if unit == '1' else ' ' + unit}"


def in_force(configured: CalibrationSettings, standing: Sequence[StandingCalibration]) -> CalibrationSettings:
    """Return the calibrations that hold. Errors: SettingError beyond a hard limit"""
    return replace(
        configured, **{each.signal: SensorCalibration(each.offset, each.gain) for each in standing}
    )


def calibration_of(points: Sequence[CalibrationPoint], configured: CalibrationSettings) -> SensorCalibration:
    """Return the calibration by one point, with the configured gain, or by two. Errors: SettingError"""
    first, last = points[0], points[-1]
    gain = float(getattr(configured, first.signal).gain)
    if len(points) > 1:
        gain = (last.true_value - first.true_value) / (last.raw - first.raw)
    found = SensorCalibration(first.true_value - gain * first.raw, gain)
    replace(configured, **{first.signal: found})
    return found


def new_point(
    signal: str, true_value: float, before: Sequence[CalibrationPoint], desk: SensorDesk, utc: float
) -> CalibrationPoint:
    """Take a point now. before : the signal's. Errors: RequestError, also DocumentError of `true_value`"""
    kind, limits = SIGNALS[signal], _limits(signal)
    if len(before) >= POINTS_MAX:
        raise RequestError(f"{signal}: there are {POINTS_MAX} points already: apply or discard them")
    read_number(true_value, f"true_value [{kind.unit}]", kind.low, kind.high)
    if signal == "temp_air" and desk.is_heating:
        # A sensor that somebody takes out of the box would let the heater run on, and heat rays mislead both.
        raise RequestError(
            f"{signal}: the heater is on, or the board is silent: start maintenance, so that nothing heats"
        )
    raw, noise = desk.minute(signal).mean()
    reads = measurement(getattr(desk.configured, signal), raw)
    if not abs(true_value - reads) <= limits.off:
        unit = "a share of 1" if kind.unit == "1" else kind.unit
        raise RequestError(
            f"{signal}: {amount(signal, true_value)} is too far from the reading of {amount(signal, reads)}: "
            f"at most {amount(signal, limits.off)}. Is the value in {unit}?"
        )
    point = CalibrationPoint(signal, true_value, raw, noise, utc)
    for other in before:
        apart = max(limits.apart, APART_NOISES * max(noise, other.noise))
        if not abs(raw - other.raw) >= apart:
            raise RequestError(
                f"{signal}: the points' readings are too close, {amount(signal, other.raw)} and "
                f"{amount(signal, raw)}: they must be {amount(signal, apart)} apart or more"
            )
    try:
        calibration_of((*before, point), desk.configured)
    except SettingError as error:
        _refuse(signal, error, len(before))
    return point


def new_calibration(points: Sequence[CalibrationPoint], desk: SensorDesk, utc: float) -> StandingCalibration:
    """Make a calibration of points, at least one, of one signal. Errors: RequestError"""
    signal = points[0].signal
    try:
        found = calibration_of(points, desk.configured)
    except SettingError as error:  # the configured gain is another one by now
        _refuse(signal, error, len(points) - 1)
    reading = desk.minute(signal).reading
    if reading.quality is not ReadingQuality.GOOD or reading.value is None:
        raise RequestError(f"{signal}: the sensor has no good reading now ({reading.quality.value})")
    reads = measurement(found, reading.value)
    if signal == "temp_air" and not reads < desk.temp_air_max_c:
        raise RequestError(
            f"{signal}: it would read {amount(signal, reads)}, and the limit is {desk.temp_air_max_c:g} °C: "
            "let the box cool down first"
        )
    return StandingCalibration(signal, found.gain, found.offset, utc)


def point_words(point: CalibrationPoint) -> str:
    """Say what a point has found."""
    signal = point.signal
    return (
        f"{signal}: the mean of raw readings was {amount(signal, point.raw)}, "
        f"their noise {amount(signal, point.noise)}, the true value {amount(signal, point.true_value)}"
    )


def states(
    points: Sequence[CalibrationPoint],
    standing: Sequence[StandingCalibration],
    configured: CalibrationSettings,
    raw: Callable[[str], Reading],
) -> Iterator[CalibrationState]:
    """Yield the state of each signal that the board has, or that has a calibration by a person."""
    present = in_force(configured, standing)
    since = {each.signal: each.utc for each in standing}
    for signal in SIGNALS:
        own = tuple(point for point in points if point.signal == signal)
        reading = raw(signal)
        good = reading.value if reading.quality is ReadingQuality.GOOD else None
        if own or signal in since or good is not None:
            following = _following(own, configured)
            yield CalibrationState(signal, getattr(present, signal), since.get(signal), own, following, good)


def _following(
    points: Sequence[CalibrationPoint], configured: CalibrationSettings
) -> SensorCalibration | None:
    try:
        return calibration_of(points, configured) if points else None
    except SettingError:  # the configured gain is another one by now; `apply_calibration` says so
        return None


def _is_good(sample: Reading) -> bool:
    if sample.quality is not ReadingQuality.GOOD or sample.value is None:
        return False
    return SIGNALS[sample.signal].low <= sample.value <= SIGNALS[sample.signal].high


def _limits(signal: str) -> PointLimits:
    return LIMITS[SIGNALS[signal].unit]


def _refuse(signal: str, error: SettingError, others: int) -> NoReturn:
    hint = ". Are the points swapped?" if others else ""
    key = error.key.removeprefix(f"{signal}.")
    raise RequestError(f"{signal}.{key}: {error.problem}{hint}") from None
