"""The lease holds at every phase of a renewal, and control recovers from one fault after another."""

import pytest
from run import run

from tests.support.virtual_board import on_cores_in_turn

LEASE_S, SILENCE_S = 10.0, 3.0
FIRST_S, EVERY_S, LASTS_S = 200.0, 60.0, 25.0  # a loss in each step, over before the next tick
PHASES = [FIRST_S + i * (EVERY_S + 0.37) for i in range(9)]  # renewals are 3 s apart


@pytest.mark.parametrize(("direction", "core"), on_cores_in_turn(["to_host", "to_board"]))
def test_the_heater_is_off_within_a_lease_whenever_the_line_falls_silent(tmp_path, direction, core):
    faults = [
        {"name": "mute", "start_s": start_s, "duration_s": LASTS_S, "direction": direction}
        for start_s in PHASES
    ]
    result = run(tmp_path, PHASES[-1] + EVERY_S, core=core, faults=faults, look_s=0.5)
    # A board that is still heard by it gets renewals until the host has noticed the silence.
    within_s = LEASE_S + (SILENCE_S if direction == "to_host" else 0.0)
    for start_s in PHASES:
        looks = [look for look in result.looks if start_s + within_s < look.time_s < start_s + LASTS_S]
        assert looks and not any(look.heater_pin for look in looks)
        assert looks[-1].heater_pin_last_on_s <= start_s + within_s
        assert looks[-1].heater_pin_last_on_s > start_s  # it was on before
    assert result.water_given_s() <= result.water_ordered_s() + 0.1 * len(result.records)


EVERYTHING = [
    {"name": "mute", "duration_s": 90},
    {"name": "unplug", "duration_s": 90},
    {"name": "sensor_nan", "duration_s": 70},
    {"name": "flip_bits", "duration_s": 90, "rate": 0.2},
    {"name": "reset", "cause": "external"},
    {"name": "sensor_value", "duration_s": 70, "value": 120},
    {"name": "drop_bytes", "duration_s": 200, "rate": 0.01},
    {"name": "clock_wrap", "before_s": 20},
    {"name": "brown_out", "count": 3},
    {"name": "duplicate_bytes", "duration_s": 200, "rate": 0.01},
    {"name": "other_protocol", "duration_s": 60},
    {"name": "sensor_spike", "duration_s": 300, "size": 8, "rate": 0.05},
    {"name": "clock_drift", "factor": 1.02},
]
SPACE_S = 300


def test_the_reference_is_tracked_again_after_one_fault_upon_another(tmp_path):
    faults = [{**fault, "start_s": 605 + i * (SPACE_S + 7)} for i, fault in enumerate(EVERYTHING)]
    settings = {"reference": {"reference_c": 28.0}}
    end_s = faults[-1]["start_s"] + 1500
    result = run(tmp_path, end_s, core="c", seed=2, faults=faults, settings=settings, look_s=20.0)
    end = [look.temp_air_c for look in result.looks if look.time_s > end_s - 900]
    assert abs(sum(end) / len(end) - 28.0) < 1.0
    assert result.hottest_c() < 32.0
    assert not any(event.key.startswith("safety.") for event in result.events)
    assert result.records[-1].link_up
    assert result.water_given_s() <= result.water_ordered_s() + 0.1 * len(result.records)
