"""Board samples in, one reading per signal and tick out: checked, averaged, calibrated.

A tick of a minute has 60 samples. The reading is the mean of the good ones of the last AVERAGE_S seconds
without the lowest and the highest: noise of half a step makes the mean finer than the sensor's 0.1 K steps,
one wild sample changes nothing, and 5 s is little beside the sensor's own lag. Older samples only add delay.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from edge.config.settings import CalibrationSettings, SensorCalibration, SensorHealthSettings
from edge.core.messages import Command, Reading, ReadingQuality
from edge.core.names import SIGNALS
from edge.safety.box_bounds import PAPER_BOX, BoxBounds
from edge.safety.memory import AirDoubt
from edge.safety.thermal_supervision import COLD_K
from edge.tick.calibration import WINDOW_S, CalibrationChange, RawMinute, measurement
from edge.tick.stillness import Stillness, is_stuck, watch

AVERAGE_S = 5.0
STALE_PERIODS = 3  # as Quality.STALE
CONFIRM_SAMPLES = 5  # so many in a row that agree are a step, not a spike
ROOM_RATE_MAX_K_S = 0.1  # no room warms or cools faster


@dataclass(frozen=True, slots=True)
class Pace:
    """How far a signal can move between two samples; light and moisture may jump."""

    jump_k: float = math.inf
    rate_k_s: float = 0.0  # a gap widens the jump by it


@dataclass(frozen=True, slots=True)
class Track:
    """The memory of one signal."""

    newest: Reading | None = None  # whatever came last
    accepted: tuple[Reading, ...] = ()  # good samples of the last AVERAGE_S, and always the last good one
    suspects: tuple[Reading, ...] = ()  # samples in a row that jumped
    jumps_s: tuple[float, ...] = ()  # times of the samples of the last AVERAGE_S that jumped
    stepped: bool = False  # a jump was confirmed since the last reading: true or not, it is worth an alarm
    fell_from: float | None = None  # value before it, where the jump went down
    still_since_s: float = math.inf  # since when the raw value has been exactly the same


class SensorHealth:
    """The tracks of all signals."""

    def __init__(
        self,
        settings: SensorHealthSettings,
        calibration: CalibrationSettings,
        box: BoxBounds = PAPER_BOX,
        air_doubt: AirDoubt | None = None,
    ) -> None:
        """`air_doubt`: of the process before."""
        self._settings = settings
        self._calibration = calibration
        self._box = box
        self._tracks = {name: Track() for name in SIGNALS}
        self._minutes = {name: deque[Reading]() for name in SIGNALS}  # raw, good or not, for a calibration
        self._is_stuck = False  # the air, at the last reading
        self._paces = {
            "temp_air": Pace(settings.air_jump_k, box.air_rate_max_k_s),
            "temp_ambient": Pace(settings.air_jump_k, ROOM_RATE_MAX_K_S),
        }
        self._still = Stillness()
        self.air_doubt = air_doubt  # until air and room agree, or a person accepts the value

    def readings(
        self, samples: Sequence[Mapping[str, Reading]], now: float, driven: Command
    ) -> dict[str, Reading]:
        """One reading per signal.

        samples : since the last call, oldest first
        driven : what the board has driven since the last call
        """
        self.take(samples)
        result, fell_from = {}, self._tracks["temp_air"].fell_from
        for name, track in self._tracks.items():
            result[name] = assess(name, track, now, self._settings, getattr(self._calibration, name))
            self._tracks[name] = replace(track, stepped=False, fell_from=None)
        self._doubt_air(fell_from, result["temp_air"], result["temp_ambient"], now)
        result["temp_air"] = self._unless_stuck(result["temp_air"], result["temp_ambient"], now, driven)
        self._is_stuck = result["temp_air"].quality is ReadingQuality.STUCK
        return result

    def take(self, samples: Sequence[Mapping[str, Reading]]) -> None:
        """Follow samples between two readings. samples : since the last call, oldest first"""
        for name, track in self._tracks.items():
            new = [sample[name] for sample in samples if name in sample]
            self._tracks[name] = follow(track, new, self._paces.get(name, Pace()))
            minute = self._minutes[name]
            minute.extend(new)
            while minute and minute[-1].time_s - minute[0].time_s >= WINDOW_S:
                minute.popleft()

    def minute(self, name: str, now: float) -> RawMinute:
        """Return the raw samples of the last while."""
        return RawMinute(tuple(self._minutes[name]), self.raw(name, now), now, self._settings.sample_period_s)

    def raw(self, name: str, now: float) -> Reading:
        """Return the present reading before its calibration."""
        reading = raw_reading(name, self._tracks[name], now, self._settings)
        is_stuck = name == "temp_air" and self._is_stuck and reading.quality is ReadingQuality.GOOD
        return replace(reading, quality=ReadingQuality.STUCK) if is_stuck else reading

    def calibrate(self, calibration: CalibrationSettings, now: float) -> list[CalibrationChange]:
        """Correct by another calibration from now on; return the signals that it changes."""
        before, self._calibration = self._calibration, calibration
        pairs = {name: (getattr(before, name), getattr(calibration, name)) for name in SIGNALS}
        return [
            CalibrationChange(name, *pair, self.raw(name, now).value)
            for name, pair in pairs.items()
            if pair[0] != pair[1]
        ]

    def _doubt_air(self, fell_from: float | None, air: Reading, room: Reading, now: float) -> None:
        """Doubt air that fell at once far below the room or, where no one measures it, below what it was."""
        if air.value is None:
            return
        before_c = None if fell_from is None else measurement(self._calibration.temp_air, fell_from)
        was_c = before_c if self.air_doubt is None else self.air_doubt.before_c
        if room.value is not None and room.quality is ReadingQuality.GOOD:
            least_c, why = room.value - COLD_K, f"while the room has {room.value:.1f} °C"
        elif was_c is not None:
            least_c, why = was_c - COLD_K, "faster than any air cools"
        else:
            return
        if not air.value < least_c:
            self.air_doubt = None if air.quality is ReadingQuality.GOOD else self.air_doubt
        elif before_c is not None and self.air_doubt is None:
            self.air_doubt = AirDoubt(now, f"from {before_c:.1f} to {air.value:.1f} °C, {why}", before_c)

    def _unless_stuck(self, air: Reading, room: Reading, now: float, driven: Command) -> Reading:
        """Return the air's reading, called stuck where the box must have moved it."""
        excess_k = None
        if air.value is not None and room.value is not None and room.quality is ReadingQuality.GOOD:
            excess_k = air.value - room.value
        since_s = self._tracks["temp_air"].still_since_s
        self._still = watch(self._still, since_s, now, driven, excess_k, self._box)
        stuck_after_s = self._settings.stuck_after_s
        if air.quality is ReadingQuality.GOOD and is_stuck(
            self._still, now, excess_k, self._box, stuck_after_s
        ):
            return replace(air, quality=ReadingQuality.STUCK)
        return air


def follow(track: Track, samples: Sequence[Reading], pace: Pace) -> Track:
    """Return the track after more samples, oldest first."""
    if not samples:
        return track
    quiet: list[Reading] = []  # good samples that follow each other without a jump, not yet in the track
    for sample in samples:
        if sample_quality(sample) is not ReadingQuality.GOOD:
            continue
        before = quiet[-1] if quiet else (track.accepted[-1] if track.accepted else None)
        if before is None or not _jumps(before, sample, pace):
            quiet.append(sample)
        else:
            track, quiet = _suspect(_accept(track, quiet), sample, pace), []
    return replace(_accept(track, quiet), newest=samples[-1])


def sample_quality(sample: Reading) -> ReadingQuality:
    """Quality of one sample by itself: the board's word, then number, then the datasheet's range."""
    if sample.quality is not ReadingQuality.GOOD:
        return sample.quality
    if sample.value is None or not math.isfinite(sample.value):
        return ReadingQuality.FAULT
    signal = SIGNALS[sample.signal]
    return ReadingQuality.GOOD if signal.low <= sample.value <= signal.high else ReadingQuality.RANGE


def _suspect(track: Track, sample: Reading, pace: Pace) -> Track:
    """Return the track after a sample that jumped from the last accepted one."""
    jumps_s = (*(t for t in track.jumps_s if sample.time_s - t < AVERAGE_S), sample.time_s)
    track = replace(track, jumps_s=jumps_s)
    agree = not track.suspects or not _jumps(track.suspects[-1], sample, pace)
    suspects = (*track.suspects, sample) if agree else (sample,)
    if len(suspects) < CONFIRM_SAMPLES:
        return replace(track, suspects=suspects)
    before = track.accepted[-1].value if track.accepted else None
    assert sample.value is not None  # it is good
    fell_from = before if before is not None and sample.value < before else track.fell_from
    return _take(replace(track, stepped=True, fell_from=fell_from, accepted=()), suspects, sample.time_s)


def _accept(track: Track, samples: Sequence[Reading]) -> Track:
    """Return the track after good samples in a row that did not jump, none or more."""
    if not samples:
        return track
    before = (track.accepted[-1].value if track.accepted else None, *(sample.value for sample in samples))
    moves_s = [s.time_s for s, value in zip(samples, before, strict=False) if s.value != value]
    return _take(track, samples, moves_s[-1] if moves_s else None)


def _take(track: Track, samples: Sequence[Reading], moved_s: float | None) -> Track:
    """Return the track with more samples. moved_s : when the raw value last moved, None: it stood still"""
    last_s = samples[-1].time_s
    recent = tuple(s for s in (*track.accepted, *samples) if last_s - s.time_s < AVERAGE_S)
    still_since_s = track.still_since_s if moved_s is None else moved_s
    return replace(track, accepted=recent, suspects=(), still_since_s=still_since_s)


def _jumps(before: Reading, sample: Reading, pace: Pace) -> bool:
    assert before.value is not None and sample.value is not None  # both are good
    allowed = pace.jump_k + pace.rate_k_s * max(0.0, sample.time_s - before.time_s)
    return abs(sample.value - before.value) > allowed


def assess(
    name: str, track: Track, now: float, settings: SensorHealthSettings, calibration: SensorCalibration
) -> Reading:
    """Return the reading of `name` at `now`, stillness aside."""
    reading = raw_reading(name, track, now, settings)
    return (
        reading if reading.value is None else replace(reading, value=measurement(calibration, reading.value))
    )


def raw_reading(name: str, track: Track, now: float, settings: SensorHealthSettings) -> Reading:
    """Return the reading of `name` at `now` before its calibration, stillness aside."""
    newest, limit_s = track.newest, STALE_PERIODS * settings.sample_period_s
    if newest is None:
        return Reading(name, None, -math.inf, ReadingQuality.STALE)
    if not track.accepted or not now - track.accepted[-1].time_s <= limit_s:
        return _not_good(track, newest, now, limit_s)
    value = trimmed_mean([s.value for s in track.accepted if s.value is not None])
    jumps = sum(1 for t in track.jumps_s if track.accepted[-1].time_s - t < AVERAGE_S)
    quality = ReadingQuality.SPIKE if track.stepped or jumps > len(track.accepted) else ReadingQuality.GOOD
    return Reading(name, value, track.accepted[-1].time_s, quality)


def _not_good(track: Track, newest: Reading, now: float, limit_s: float) -> Reading:
    quality = sample_quality(newest)
    if quality is ReadingQuality.GOOD:
        quality = ReadingQuality.SPIKE  # good by itself but not accepted
    if quality is not ReadingQuality.ABSENT and not now - newest.time_s <= limit_s:
        quality = ReadingQuality.STALE
    number = newest.value is not None and math.isfinite(newest.value)
    return Reading(newest.signal, newest.value if number else None, newest.time_s, quality)


def trimmed_mean(values: Sequence[float]) -> float:
    """Mean without the lowest and the highest, where there are at least three values."""
    inner = sorted(values)[1:-1] if len(values) >= 3 else values
    return math.fsum(inner) / len(inner)
