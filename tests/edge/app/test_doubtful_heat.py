"""A rig that cannot bound its heat, and a sensor that falls to 0.0: the whole daemon in simulated time."""

from dataclasses import replace
from pathlib import Path

import pytest

from edge.board.virtual_rig import settings_in
from edge.config import loading as config
from edge.config.settings import BoxSettings
from edge.core.messages import ReadingQuality, Severity
from training.lab import Lab

SETTINGS = config.parse(
    "{timezone: UTC, control: {controller: PID}, drift: {enabled: false}, reference: {reference_c: 26}}",
    "test",
)


def test_a_rig_whose_heater_is_unknown_does_not_heat_and_says_so(tmp_path: Path) -> None:
    settings = replace(settings_in(tmp_path, SETTINGS), box=BoxSettings())
    with Lab(settings, board="here", folder=tmp_path) as lab:
        lab.run(minutes=5)
        status = lab._daemon.status()
    assert {tick.sent.heater_duty for tick in lab.history} == {0.0}
    (event,) = (e for e in lab.history[0].events if e.key == "heater.unknown_power")
    assert event.severity is Severity.ALARM and "box: {heater_w: 100}" in event.text
    assert status.conditions == ("heater.unknown_power",)


def test_a_virtual_rig_knows_its_heater() -> None:
    with Lab(SETTINGS, board="here") as lab:
        assert lab.settings.box.heater_w == 100.0
        lab.run(minutes=3)
    assert max(tick.sent.heater_duty for tick in lab.history) > 0.0


@pytest.mark.slow
def test_a_sensor_that_falls_to_zero_in_a_warm_room_gets_no_full_heat() -> None:
    """Believed after 5 s, it had full heat for 14 minutes."""
    fault = {
        "name": "sensor_value",
        "signal": "temp_air_c",
        "value": 0.0,
        "start_s": 3600.0,
        "duration_s": 1500.0,
    }
    with Lab(SETTINGS, faults=[fault], with_truth=True) as lab:
        lab.run(minutes=95)
    ticks = lab.history
    held = [tick.sent.heater_duty for tick in ticks if 1800.0 < tick.time_s < 3600.0]
    mean = sum(held) / len(held)
    fallen = [tick for tick in ticks if tick.readings["temp_air"].value == 0.0]
    assert len(fallen) >= 24
    assert max(tick.sent.heater_duty for tick in fallen) <= mean + 0.05
    assert {tick.sent.heater_duty for tick in fallen if tick.time_s > 3600.0 + 720.0} == {0.0}
    (event,) = (e for tick in ticks for e in tick.events if e.key == "air.jump_contradicted")
    assert event.severity is Severity.ALARM and " to 0.0 °C, while the room has 2" in event.text
    after = [tick for tick in ticks if tick.time_s > 5300.0]
    assert max(tick.sent.heater_duty for tick in after) > 0.0  # the readings agree again
    assert all(tick.readings["temp_air"].quality is ReadingQuality.GOOD for tick in after)
    assert max(truth["temp_air_c"] for truth in lab.truths) < 28.0
