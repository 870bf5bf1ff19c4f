"""Hours without a fault: no alarm and no trip, whatever the reference, the fan, the lamp and the door do."""

from run import run

HALF_AN_HOUR_S = 1800
REFERENCES_C = (30, 24, 35, 22, 28, 26)  # half an hour each; the ways down need the fan


def test_no_alarm_without_a_fault(tmp_path):
    steps = [{"at_s": i * HALF_AN_HOUR_S, "reference_c": value} for i, value in enumerate(REFERENCES_C)]
    settings = {
        "reference": {"kind": "steps", "steps": steps},
        "lighting": {"enabled": True, "on": "00:40", "off": "01:50", "level": 0.8},
        "timezone": "UTC",
    }
    chamber = {"effects": {"door_opening": 1.0}}
    result = run(
        tmp_path,
        len(steps) * HALF_AN_HOUR_S,
        core="c",
        seed=2,
        settings=settings,
        chamber=chamber,
        look_s=60.0,
    )
    assert [event for event in result.events if event.severity == "alarm"] == []
    assert not any(record.echo is None or record.echo.tripped for record in result.records)
    assert any(record.sent.fan_on for record in result.records)
    assert any(look.fan for look in result.looks)
    assert result.water_given_s() > 0.0
    assert result.hottest_c() < 40.0
