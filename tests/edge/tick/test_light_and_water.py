"""edge/tick/light_and_water.py: the photoperiod at its edges; when a pulse is given, and when not."""

import math
from datetime import time

import pytest

from edge.config.settings import LightingSettings, WateringSettings
from edge.core.messages import Reading, ReadingQuality
from edge.safety.memory import Dose
from edge.tick.light_and_water import led_level, watering_pulse

DAY = LightingSettings(enabled=True, on=time(6), off=time(22), level=0.8)
NIGHT = LightingSettings(enabled=True, on=time(22), off=time(6), level=0.8)


@pytest.mark.parametrize(
    ("hour", "day", "night"),
    [(0, 0.0, 0.8), (5.999, 0.0, 0.8), (6, 0.8, 0.0), (21.999, 0.8, 0.0), (22, 0.0, 0.8), (23.9, 0.0, 0.8)],
)
def test_the_light_follows_the_clock(hour: float, day: float, night: float) -> None:
    assert led_level(DAY, hour * 3600.0) == day
    assert led_level(NIGHT, hour * 3600.0) == night


def test_a_disabled_photoperiod_gives_no_light() -> None:
    assert led_level(LightingSettings(enabled=False, on=time(0), off=time(23)), 3600.0) == 0.0


# water

WATER = WateringSettings(enabled=True, threshold=0.3, pulse_s=2.0, soak_s=600.0, daily_max_s=5.0)


UTC = 1.75e9


def pulse(reading: Reading | None, now: float, *given_s: float, settings: WateringSettings = WATER) -> float:
    doses = [Dose(at_s, UTC, 2.0) for at_s in given_s]
    return watering_pulse(settings, reading, doses, now, UTC)


def soil(value: float | None, quality: ReadingQuality = ReadingQuality.GOOD) -> Reading:
    return Reading("soil_moisture", value, 0.0, quality)


@pytest.mark.parametrize(
    ("value", "pulse_s"), [(0.0, 2.0), (0.2999, 2.0), (0.3, 0.0), (0.9, 0.0), (None, 0.0), (math.nan, 0.0)]
)
def test_only_dry_soil_gets_water(value: float | None, pulse_s: float) -> None:
    assert pulse(soil(value), 0.0) == pulse_s


@pytest.mark.parametrize(
    "quality", [quality for quality in ReadingQuality if quality is not ReadingQuality.GOOD]
)
def test_a_soil_sensor_that_is_not_good_gives_no_water(quality: ReadingQuality) -> None:
    assert pulse(soil(0.1, quality), 0.0) == 0.0


def test_no_sensor_no_water() -> None:
    assert pulse(None, 0.0) == 0.0


def test_water_gets_time_to_arrive() -> None:
    assert pulse(soil(0.1), 699.9, 100.0) == 0.0
    assert pulse(soil(0.1), 700.0, 100.0) == 2.0


def test_the_daily_dose_ends_the_pulses_until_a_day_has_passed() -> None:
    given_s = (0.0, 1000.0)  # a third pulse of 2 s would make 6 s, above 5 s
    assert pulse(soil(0.1), 5000.0, *given_s) == 0.0
    assert pulse(soil(0.1), 86400.0, *given_s) == 2.0  # the first one is a day old


def test_a_dose_of_an_older_state_file_counts_by_the_wall_clock() -> None:
    dose = Dose(None, UTC, 2.0)
    ages = (-3600.0, 599.0, 600.0)  # the first: the clock was set back
    assert [watering_pulse(WATER, soil(0.1), [dose], 5.0, UTC + age_s) for age_s in ages] == [0.0, 0.0, 2.0]


def test_disabled_watering_gives_nothing() -> None:
    assert pulse(soil(0.0), 0.0, settings=WateringSettings(enabled=False)) == 0.0
