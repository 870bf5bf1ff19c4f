"""Faults that show only in the air: the alarm in time, and no warmer than stated in bounds.yaml."""

from pathlib import Path

import pytest
from bounds import LOOK_S, BoundCase, cases
from run import ScenarioRun

from tests.support.virtual_board import on_cores_in_turn

ROOT = Path(__file__).parents[2]
MARGIN_S = 120.0  # two ticks
# By bounds.py. tests/edge/safety and tests/edge/tick/test_sensor_health.py try what supervises them.
ONLY_MEASURED = {
    "the same in a room of 27 °C",
    "relay stuck on while 26 °C is held",
    "relay stuck on, a thermostat at 26 °C",
    "heater dies at 30 °C",
    "sensor stuck at 28 °C, then 32 asked",
    "sensor 5 K too low from the start",
}
TRIED = [case for case in cases() if case.name not in ONLY_MEASURED]


# Each fault on one of the two boards in turn: bounds.py measures both, the conformance tests hold them alike.
@pytest.mark.parametrize(
    ("case", "core"),
    [pytest.param(case, core, id=case.name) for case, core in on_cores_in_turn(TRIED)],
)
def test_the_alarm_and_the_temperature_keep_their_bounds(tmp_path, case, core):
    result = case.run(tmp_path, core, seed=1)
    assert result.hottest_c(case.fault_s) <= case.temp_max_c
    if case.alarm is None:
        return
    after_s = case.alarm_after_s(result)
    assert after_s is not None and 0.0 < after_s <= case.alarm_max_s
    other_parts = {key for key in result.told("alarm") if key.startswith("safety.")} - {case.alarm}
    assert other_parts == set()
    check_answer(result, case)


def check_answer(result: ScenarioRun, case: BoundCase) -> None:
    """A named part ends all heating; a stuck relay gets the fan, and the cut-off where there is one."""
    alarm = result.first(case.alarm)
    looks = [look for look in result.looks if look.time_s > alarm.time_s + LOOK_S]
    assert looks
    if case.alarm.startswith("safety."):
        assert not any(look.heater_pin for look in looks)
    if case.alarm == "safety.heater_stuck_on":
        assert all(look.fan for look in looks)
        assert all(look.cutoff_open is bool(case.board) for look in looks)
        assert all(look.heat is not bool(case.board) for look in looks)
        assert looks[-1].temp_air_c < result.hottest_c(case.fault_s)


def test_the_printed_figures_are_within_the_stated_margin_of_the_bounds():
    printed = (ROOT / "bench/results/fault_bounds.txt").read_text(encoding="utf-8").splitlines()[3:]
    page = (ROOT / "docs/measured/rig.md").read_text(encoding="utf-8")
    for line, case in zip(printed, cases(), strict=True):
        assert line.startswith(case.name)
        *_, after, alarm_max, hottest, temp_max = line.split()
        assert float(temp_max) == case.temp_max_c
        assert 0.0 < case.temp_max_c - float(hottest) < 1.0 + 0.15  # printed to a tenth
        assert (
            f"{float(hottest):.1f} ({case.temp_max_c:.1f})" in page
            or case.name == "the same, then the rig is off"
        )
        if case.alarm:
            worst_s = float(after.rpartition("..")[2])
            assert float(alarm_max) == case.alarm_max_s
            assert 0.0 < case.alarm_max_s - worst_s <= MARGIN_S
            assert f"{worst_s:.0f} ({case.alarm_max_s:.0f})" in page
