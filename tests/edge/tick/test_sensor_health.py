"""edge/tick/sensor_health.py."""

import math
import random
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.config.settings import CalibrationSettings, SensorCalibration, SensorHealthSettings
from edge.core.messages import Command, Reading, ReadingQuality
from edge.core.names import SIGNALS
from edge.safety.box_bounds import PAPER_BOX, BoxBounds, unknown_box
from edge.tick.sensor_health import CONFIRM_SAMPLES, Pace, SensorHealth, Track, follow, trimmed_mean

OFF = Command()


def air(
    value: float | None, time_s: float, quality: ReadingQuality = ReadingQuality.GOOD
) -> dict[str, Reading]:
    return {"temp_air": Reading("temp_air", value, time_s, quality)}


def health(**calibration: SensorCalibration) -> SensorHealth:
    return SensorHealth(SensorHealthSettings(), CalibrationSettings(**calibration))


def after(values: list[float | None], sensors: SensorHealth | None = None, start_s: float = 0.0) -> Reading:
    """The reading at the time of the last of these samples, one a second."""
    samples = [air(value, start_s + second) for second, value in enumerate(values)]
    now = start_s + len(values) - 1
    return (sensors or health()).readings(samples, now, OFF)["temp_air"]


@pytest.mark.parametrize("seed", range(20))
def test_samples_that_come_in_pieces_give_the_same_readings(seed: int):
    noise, whole, pieces = random.Random(seed), health(), health()
    for tick in range(20):
        values = [noise.choice((22.0, 22.1, 24.5, 30.0, None)) for _ in range(20)]
        samples = [air(value, 20.0 * tick + second) for second, value in enumerate(values)]
        cut = noise.randrange(20)
        pieces.take(samples[:cut])
        now = 20.0 * tick + 19.0
        assert pieces.readings(samples[cut:], now, OFF) == whole.readings(samples, now, OFF)


def test_before_any_sample_every_signal_is_stale_without_a_number():
    readings = health().readings([], 0.0, OFF)
    assert set(readings) == set(SIGNALS)
    assert all(r.quality is ReadingQuality.STALE and r.value is None for r in readings.values())


def test_a_first_good_sample_is_a_good_reading():
    assert after([23.4]) == Reading("temp_air", 23.4, 0.0, ReadingQuality.GOOD)


def test_a_reading_is_the_mean_of_the_last_seconds():
    assert after([30.0] * 3 + [24.0 + 0.1 * k for k in range(60)]).value == pytest.approx(29.7)


def test_noise_of_half_a_step_makes_the_mean_finer_than_the_step():
    noise = random.Random(1)
    errors = []
    sensors = health()
    for tick in range(200):
        true = 24.0 + 0.001 * tick
        values = [round(true + noise.gauss(0.0, 0.06), 1) for _ in range(5)]
        reading = after(values, sensors, start_s=60.0 * tick)
        errors.append(reading.value - true)
    assert math.sqrt(sum(e * e for e in errors) / len(errors)) < 0.05  # a single one: 0.067


@pytest.mark.parametrize(
    ("age_s", "quality"),
    [
        (0.0, ReadingQuality.GOOD),
        (2.99, ReadingQuality.GOOD),
        (3.0, ReadingQuality.GOOD),
        (3.01, ReadingQuality.STALE),
        (1e9, ReadingQuality.STALE),
    ],
)
def test_a_sample_older_than_three_periods_is_stale(age_s, quality):
    sensors = health()
    reading = sensors.readings([air(24.0, 100.0)], 100.0 + age_s, OFF)["temp_air"]
    assert (reading.quality, reading.value, reading.time_s) == (quality, 24.0, 100.0)


def test_a_slower_board_has_later_stale_readings():
    sensors = SensorHealth(SensorHealthSettings(sample_period_s=10.0), CalibrationSettings())
    assert sensors.readings([air(24.0, 0.0)], 30.0, OFF)["temp_air"].quality is ReadingQuality.GOOD
    assert sensors.readings([], 30.1, OFF)["temp_air"].quality is ReadingQuality.STALE


@pytest.mark.parametrize(
    ("value", "quality"),
    [
        (-20.0, ReadingQuality.GOOD),
        (80.0, ReadingQuality.GOOD),
        (-20.01, ReadingQuality.RANGE),
        (80.01, ReadingQuality.RANGE),
        (1e9, ReadingQuality.RANGE),
        (math.nan, ReadingQuality.FAULT),
        (math.inf, ReadingQuality.FAULT),
        (-math.inf, ReadingQuality.FAULT),
        (None, ReadingQuality.FAULT),
    ],
)
def test_a_number_no_sensor_can_give_is_no_measurement(value, quality):
    assert after([value]).quality is quality


@pytest.mark.parametrize(
    "quality", [ReadingQuality.FAULT, ReadingQuality.STALE, ReadingQuality.RANGE, ReadingQuality.ABSENT]
)
def test_the_boards_word_stands(quality):
    reading = health().readings([air(24.0, 0.0, quality)], 0.0, OFF)["temp_air"]
    assert reading.quality is quality


def test_an_absent_sensor_stays_absent():
    sensors = health()
    sensors.readings([air(None, 0.0, ReadingQuality.ABSENT)], 0.0, OFF)
    assert sensors.readings([], 1000.0, OFF)["temp_air"].quality is ReadingQuality.ABSENT


def test_one_bad_sample_among_good_ones_changes_nothing():
    sensors = health()
    samples = [air(24.0, 0.0), air(24.2, 1.0), air(None, 2.0, ReadingQuality.FAULT)]
    assert sensors.readings(samples, 2.0, OFF)["temp_air"].quality is ReadingQuality.GOOD


def test_a_sensor_that_dies_is_bad_after_three_periods_at_the_latest():
    sensors = health()
    samples = [air(24.0, 0.0), *(air(math.nan, float(k)) for k in range(1, 5))]
    assert sensors.readings(samples, 4.0, OFF)["temp_air"].quality is ReadingQuality.FAULT


def test_a_spike_changes_nothing():
    reading = after([24.0] * 5 + [50.0] + [24.0])
    assert (reading.value, reading.quality) == (24.0, ReadingQuality.GOOD)


def test_spikes_that_do_not_agree_are_never_believed():
    noise = random.Random(2)
    reading = after([24.0] + [noise.uniform(-20.0, 80.0) for _ in range(60)])
    assert reading.quality is ReadingQuality.SPIKE


def test_a_true_step_is_accepted_after_a_few_samples_and_told_once():
    sensors = health()
    assert after([24.0] + [34.0] * (CONFIRM_SAMPLES - 1), sensors).quality is ReadingQuality.SPIKE
    told = sensors.readings([air(34.0, 5.0)], 5.0, OFF)["temp_air"]
    assert (told.value, told.quality) == (34.0, ReadingQuality.SPIKE)
    assert sensors.readings([air(34.0, 6.0)], 6.0, OFF)["temp_air"].quality is ReadingQuality.GOOD


def test_a_step_within_a_long_control_step_is_told_too():
    sensors = health()
    assert after([24.0] * 30 + [29.0] * 30, sensors).quality is ReadingQuality.SPIKE
    assert after([29.0] * 60, sensors, start_s=60.0).quality is ReadingQuality.GOOD


@pytest.mark.parametrize("jump_k", [2.05, -2.05])
def test_a_change_the_box_can_make_is_no_spike(jump_k):
    assert after([24.0, 24.0 + jump_k]).quality is ReadingQuality.GOOD


def test_after_a_gap_more_change_is_possible():
    sensors = health()
    after([24.0], sensors)
    reading = sensors.readings([air(32.0, 100.0)], 100.0, OFF)["temp_air"]
    assert (reading.value, reading.quality) == (32.0, ReadingQuality.GOOD)


def test_how_fast_the_air_may_move_is_the_boxs_own_the_room_has_one_speed():
    quick = replace(PAPER_BOX, air_rate_max_k_s=0.5)
    sensors = SensorHealth(SensorHealthSettings(), CalibrationSettings(), quick)
    assert after([24.0, 26.4], sensors).value == pytest.approx(25.2)
    assert after([24.0, 26.4]).value == 24.0  # the second one waits to be confirmed
    room = [
        {"temp_ambient": Reading("temp_ambient", value, float(second), ReadingQuality.GOOD)}
        for second, value in enumerate((20.0, 22.4))
    ]
    assert sensors.readings(room, 1.0, OFF)["temp_ambient"].value == 20.0


def test_light_may_jump():
    sensors = health()
    for second, value in enumerate((0.0, 1.0, 0.0)):
        sample = {"light": Reading("light", value, float(second), ReadingQuality.GOOD)}
        assert sensors.readings([sample], float(second), OFF)["light"].quality is ReadingQuality.GOOD


def minutes(
    sensors: SensorHealth,
    start: int,
    values: list[float],
    duty: float,
    room_c: float | None = 20.0,
    fan: bool = False,
) -> ReadingQuality:
    """A tick a minute; the quality at the end."""
    for minute, value in enumerate(values, start):
        now = 60.0 * minute
        sample = air(value, now)
        if room_c is not None:
            sample["temp_ambient"] = Reading("temp_ambient", room_c, now, ReadingQuality.GOOD)
        readings = sensors.readings([sample], now, Command(heater_duty=duty, fan_on=fan))
    return readings["temp_air"].quality


def held(duty: float, air_c: float = 26.0, box: BoxBounds = PAPER_BOX, fan: bool = False) -> SensorHealth:
    """The sensors of a box held for an hour, up to minute 59, in which the air last moves."""
    sensors = SensorHealth(SensorHealthSettings(), CalibrationSettings(), box)
    for minute in range(60):
        minutes(sensors, minute, [air_c - 0.1 * (minute % 2 == 0)], duty, fan=fan)
    return sensors


def test_a_sensor_that_stands_still_while_the_heat_goes_is_stuck():
    sensors = held(0.6)
    # 0.6 of 75 W less, of which sun and walls may give 30 W: 10 kJ, 1 K of the heaviest box, in 11.1 min
    assert minutes(sensors, 60, [26.0] * 11, duty=0.0) is ReadingQuality.GOOD
    assert minutes(sensors, 71, [26.0], duty=0.0) is ReadingQuality.STUCK


def test_a_sensor_that_stands_still_under_more_heat_is_stuck_if_the_heater_is_known_to_work():
    assert minutes(held(0.3), 60, [26.0] * 30, duty=1.0) is ReadingQuality.STUCK
    cold = held(0.0, air_c=20.5)
    assert minutes(cold, 60, [20.5] * 600, duty=1.0) is ReadingQuality.GOOD  # as of a dead heater


@pytest.mark.parametrize("duty", [0.3, 0.6, 0.8])
def test_in_a_well_held_box_the_sensor_may_be_still_for_hours_while_the_heat_follows_the_room(duty):
    sensors = held(duty)
    for minute in range(60, 60 + 240):
        now_duty = duty + 0.1 * math.sin(minute / 20.0)
        assert minutes(sensors, minute, [26.0], now_duty) is ReadingQuality.GOOD


def test_the_fan_explains_heat_that_changes_with_it():
    assert minutes(held(0.1), 60, [26.0] * 60, duty=0.9, fan=True) is ReadingQuality.GOOD
    assert minutes(held(0.9, fan=True), 60, [26.0] * 60, duty=0.1) is ReadingQuality.GOOD
    assert minutes(held(0.9), 60, [26.0] * 60, duty=0.1, fan=True) is ReadingQuality.STUCK


def test_a_sensor_that_stands_still_under_full_heat_far_from_the_reach_is_stuck():
    sensors = held(1.0)
    assert minutes(sensors, 60, [26.0] * 19, duty=1.0) is ReadingQuality.GOOD  # nineteen minutes
    assert minutes(sensors, 79, [26.0], duty=1.0) is ReadingQuality.STUCK  # twenty
    assert minutes(held(1.0, air_c=34.0), 60, [34.0] * 600, duty=1.0) is ReadingQuality.GOOD  # at the reach


def test_a_light_box_shows_a_stuck_sensor_sooner_than_a_heavy_one():
    light, heavy = (replace(PAPER_BOX, capacity_max_j_k=capacity) for capacity in (2e3, 1e5))
    quality = [
        minutes(held(0.6, box=box), 60, [26.0] * minute, duty=0.0)
        for box, minute in ((light, 10), (heavy, 10), (heavy, 112))
    ]
    assert quality == [ReadingQuality.STUCK, ReadingQuality.GOOD, ReadingQuality.STUCK]


@pytest.mark.parametrize(
    ("box", "duty", "quality"),
    [
        (PAPER_BOX, 1.0, ReadingQuality.STUCK),
        (PAPER_BOX, 0.9, ReadingQuality.GOOD),
        (unknown_box(100.0, "exhaust"), 0.5, ReadingQuality.STUCK),
        (unknown_box(100.0, "exhaust"), 0.45, ReadingQuality.GOOD),
    ],
)
def test_where_nothing_can_be_reckoned_strong_heat_for_twenty_minutes_is_enough(box, duty, quality):
    sensors = SensorHealth(SensorHealthSettings(), CalibrationSettings(), box)
    assert minutes(sensors, 0, [29.0] * 20, duty, room_c=None) is ReadingQuality.GOOD
    assert minutes(sensors, 20, [29.0] * 100, duty, room_c=None) is quality


def test_one_step_of_the_sensor_frees_it():
    sensors = held(0.6)
    assert minutes(sensors, 60, [26.0] * 20, duty=0.0) is ReadingQuality.STUCK
    assert minutes(sensors, 80, [26.1], duty=0.0) is ReadingQuality.GOOD


def test_a_noisy_sensor_in_steps_of_a_tenth_is_never_stuck():
    noise = random.Random(3)
    sensors = health()
    values = [round(24.0 + noise.gauss(0.0, 0.06), 1) for _ in range(600)]
    for start in range(0, 600, 60):
        assert (
            minutes(sensors, start, values[start : start + 60], duty=float(start % 120 == 0))
            is ReadingQuality.GOOD
        )


def test_calibration_multiplies_then_adds():
    sensors = health(temp_air=SensorCalibration(offset=-0.5, gain=1.02))
    assert after([25.0], sensors).value == pytest.approx(25.0)


def test_the_range_is_that_of_the_sensor_not_of_the_calibrated_value():
    sensors = health(temp_air=SensorCalibration(offset=5.0))
    assert after([79.0], sensors).quality is ReadingQuality.GOOD


@pytest.mark.parametrize(
    ("values", "mean"),
    [([1.0], 1.0), ([1.0, 2.0], 1.5), ([1.0, 2.0, 90.0], 2.0), ([0.0, 1.0, 2.0, 90.0], 1.5)],
)
def test_the_trimmed_mean_leaves_out_the_outermost(values, mean):
    assert trimmed_mean(values) == mean


samples_strategy = st.lists(
    st.tuples(
        st.none() | st.floats(allow_nan=True, allow_infinity=True) | st.floats(-25.0, 85.0),
        st.sampled_from(list(ReadingQuality)),
        st.floats(0.0, 30.0),
    ),
    max_size=30,
)


@given(samples_strategy, st.floats(0.0, 5.0))
def test_a_good_reading_is_always_a_fresh_number_of_the_sensors_range(samples, wait_s):
    now, sensors, series = 0.0, health(), []
    for value, quality, gap_s in samples:
        now += gap_s
        series.append(air(value, now, quality))
    reading = sensors.readings(series, now + wait_s, OFF)["temp_air"]
    if reading.quality is ReadingQuality.GOOD:
        assert reading.value is not None and -20.0 <= reading.value <= 80.0
        assert now + wait_s - reading.time_s <= 3.0
    else:
        assert reading.value is None or math.isfinite(reading.value)


SOME_VALUES = st.sampled_from([None, math.nan, 20.0, 20.0, 20.1, 20.1, 24.0, 24.1, 30.0, 200.0])


@given(st.lists(st.tuples(SOME_VALUES, st.sampled_from([0.5, 1.0, 1.0, 6.0])), max_size=40))
def test_samples_taken_together_leave_the_track_of_samples_taken_one_by_one(steps):
    pace, now, samples = Pace(2.0, 0.1), 0.0, []
    for value, after_s in steps:
        now += after_s
        samples.append(air(value, now)["temp_air"])
    one_by_one = Track()
    for sample in samples:
        one_by_one = follow(one_by_one, [sample], pace)
    assert repr(follow(Track(), samples, pace)) == repr(one_by_one)  # NaN differs from itself


def fallen(
    air_c: float, room_c: float | None = 21.4, room_quality: ReadingQuality = ReadingQuality.GOOD
) -> SensorHealth:
    """Air of 21 °C that is at `air_c` from the sixth second on, judged at a tick of ten seconds."""
    sensors = health()
    one_tick(sensors, 0.0, [21.0] * 5 + [air_c] * 5, room_c, room_quality)
    return sensors


def one_tick(
    sensors: SensorHealth,
    start_s: float,
    values: list[float],
    room_c: float | None = 21.4,
    room_quality: ReadingQuality = ReadingQuality.GOOD,
) -> None:
    samples = []
    for second, value in enumerate(values):
        sample = air(value, start_s + second)
        sample["temp_ambient"] = Reading("temp_ambient", room_c, start_s + second, room_quality)
        samples.append(sample)
    sensors.readings(samples, start_s + len(values) - 1.0, OFF)


@pytest.mark.parametrize(
    ("air_c", "room_c", "is_doubted"),
    [
        (0.0, 21.4, True),
        (17.3, 21.4, True),
        (17.4, 21.4, False),  # 4 K: wet soil cools the air by less
        (18.0, 21.4, False),  # a lid that is opened lets in the room
        (0.0, 3.0, False),  # and a cold one too
        (0.0, None, True),
        (16.9, None, True),
        (17.0, None, False),
        (45.0, 60.0, False),  # the air rose: more heat is not asked for
    ],
)
def test_air_that_fell_at_once_below_the_room_is_doubted(air_c, room_c, is_doubted):
    doubt = fallen(air_c, room_c).air_doubt
    assert (doubt is not None) is is_doubted
    if doubt is not None:
        assert doubt.since_s == 9.0
        why = "faster than any air cools" if room_c is None else "while the room has 21.4 °C"
        assert doubt.words == f"from 21.0 to {air_c:.1f} °C, {why}"


def test_without_a_good_room_sensor_a_doubt_lasts_until_the_air_is_near_what_it_was():
    sensors = fallen(0.0, 3.0, ReadingQuality.FAULT)
    for start_s, value, is_doubted in ((60.0, 0.0, True), (120.0, 16.9, True), (180.0, 17.1, False)):
        for later_s in (0.0, 10.0):  # a step up is told once
            one_tick(sensors, start_s + later_s, [value] * 10, None)
        assert (sensors.air_doubt is not None) is is_doubted


def test_air_that_cools_slowly_is_not_doubted_nor_air_that_was_cold_from_the_start():
    sensors = health()
    for tick in range(60):
        one_tick(sensors, 60.0 * tick, [21.0 - 0.3 * tick] * 10)
    assert sensors.air_doubt is None
    one_tick(fresh := health(), 0.0, [0.0] * 10)
    assert fresh.air_doubt is None


def test_a_doubt_lasts_until_air_and_room_agree_whatever_comes_between():
    sensors = fallen(0.0)
    for start_s, value in ((60.0, 0.0), (120.0, -10.0), (180.0, math.nan), (240.0, -10.0)):
        one_tick(sensors, start_s, [value] * 10)
        assert sensors.air_doubt is not None and sensors.air_doubt.since_s == 9.0
    one_tick(sensors, 300.0, [21.0] * 10)  # a step up, told once
    one_tick(sensors, 360.0, [21.0] * 10)
    assert sensors.air_doubt is None
