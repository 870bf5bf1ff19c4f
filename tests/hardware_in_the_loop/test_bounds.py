"""Faults that show only in the air: the alarm in time, and no warmer than stated in bounds.yaml."""

import pytest
from bounds import LOOK_S, Case, cases
from run import Run


@pytest.mark.parametrize("core", ["python", "c"])
@pytest.mark.parametrize("case", cases(), ids=lambda case: case.name)
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


def check_answer(result: Run, case: Case) -> None:
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
