"""edge/tick/light_and_water.py: the photoperiod at its edges."""

from datetime import time

import pytest

from edge.config.settings import LightingSettings
from edge.tick.light_and_water import led_level

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
