"""edge/tick/light_and_water.py: when a pulse is given, and above all when not."""

import math

import pytest

from edge.config.settings import WateringSettings
from edge.core.messages import Reading, ReadingQuality
from edge.tick.light_and_water import Watering

SETTINGS = WateringSettings(enabled=True, threshold=0.3, pulse_s=2.0, soak_s=600.0, daily_max_s=5.0)


def soil(value: float | None, quality: ReadingQuality = ReadingQuality.GOOD) -> Reading:
    return Reading("soil_moisture", value, 0.0, quality)


@pytest.mark.parametrize(
    ("value", "pulse_s"), [(0.0, 2.0), (0.2999, 2.0), (0.3, 0.0), (0.9, 0.0), (None, 0.0), (math.nan, 0.0)]
)
def test_only_dry_soil_gets_water(value: float | None, pulse_s: float) -> None:
    assert Watering(SETTINGS).pulse(soil(value), 0.0) == pulse_s


@pytest.mark.parametrize(
    "quality", [quality for quality in ReadingQuality if quality is not ReadingQuality.GOOD]
)
def test_a_soil_sensor_that_is_not_good_gives_no_water(quality: ReadingQuality) -> None:
    assert Watering(SETTINGS).pulse(soil(0.1, quality), 0.0) == 0.0


def test_no_sensor_no_water() -> None:
    assert Watering(SETTINGS).pulse(None, 0.0) == 0.0


def test_water_gets_time_to_arrive() -> None:
    watering = Watering(SETTINGS)
    watering.count_pulse(2.0, 100.0)
    assert watering.pulse(soil(0.1), 699.9) == 0.0
    assert watering.pulse(soil(0.1), 700.0) == 2.0


def test_the_daily_dose_ends_the_pulses_until_a_day_has_passed() -> None:
    watering = Watering(SETTINGS)
    watering.count_pulse(2.0, 0.0)
    watering.count_pulse(2.0, 1000.0)  # a third pulse of 2 s would make 6 s, above 5 s
    assert watering.pulse(soil(0.1), 5000.0) == 0.0
    assert watering.pulse(soil(0.1), 86400.0) == 2.0  # the first one is a day old


def test_disabled_watering_gives_nothing() -> None:
    assert Watering(WateringSettings(enabled=False)).pulse(soil(0.0), 0.0) == 0.0
