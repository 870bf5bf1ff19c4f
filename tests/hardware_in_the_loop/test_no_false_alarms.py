"""Hours without a fault: no alarm and no trip, whatever the reference, the fan, the lamp and the door do."""

import pytest
from run import run

HOUR_S = 3600
REFERENCES_C = (30, 24, 35, 22, 28, 26)  # an hour each; the ways down need the fan


@pytest.mark.parametrize(("core", "seed", "hours"), [("python", 1, 2), ("c", 2, 6)])
def test_no_alarm_without_a_fault(tmp_path, core, seed, hours):
    steps = [{"at_s": i * HOUR_S, "reference_c": value} for i, value in enumerate(REFERENCES_C)]
    settings = {
        "reference": {"kind": "steps", "steps": steps},
        "lighting": {"enabled": True, "on": "02:00", "off": "03:30", "level": 0.8},
        "timezone": "UTC",
    }
    chamber = {"effects": {"door_opening": 1.0}}
    result = run(
        tmp_path, hours * HOUR_S, core=core, seed=seed, settings=settings, chamber=chamber, look_s=60.0
    )
    assert [event for event in result.events if event.severity == "alarm"] == []
    assert not any(record.echo is None or record.echo.tripped for record in result.records)
    assert any(record.sent.fan_on for record in result.records)
    assert any(look.fan for look in result.looks)
    assert result.water_given_s() > 0.0
    assert result.hottest_c() < 40.0
