"""Every fault of the line, the board and the sensors: heater off in time, told, and control recovers."""

import pytest
from run import ScenarioRun, run
from scenario import FOLDER, Scenario, names, read

PULSE_STEP_S = 0.1  # the board looks at its valve this often
HEAT_BEGINS_S = 5.0  # ticks begin 1 s after the start


@pytest.mark.parametrize("core", ["python", "c"])
@pytest.mark.parametrize("name", names())
def test_scenario(tmp_path, name, core):
    scenario = read(FOLDER / f"{name}.yaml")
    result = run(
        tmp_path,
        scenario.end_s,
        core=core,
        faults=scenario.faults,
        orders=scenario.given(),
        settings=scenario.settings,
        board=scenario.board,
        chamber=scenario.chamber,
    )
    check_heat(result, scenario)
    check_history(result, scenario)
    check_valve(result)
    assert sum(not reply["ok"] for reply in result.replies) == scenario.orders_refused
    assert not result.truth["pins"]["heater_relay"], "the daemon has ended with the heater on"


def check_heat(result: ScenarioRun, scenario: Scenario) -> None:
    """On before it begins, off in time, on again."""
    begins = [fault["start_s"] for fault in scenario.faults] + [order["at_s"] for order in scenario.orders]
    begin_s = min(begins, default=scenario.end_s)
    assert all(look.heater_pin for look in result.looks if HEAT_BEGINS_S < look.time_s < begin_s)
    for off in scenario.heater_off:
        limit_s = off.from_s + off.within_s
        looks = [look for look in result.looks if limit_s < look.time_s <= off.until_s]
        assert looks
        assert max(look.heater_pin_last_on_s for look in looks) <= limit_s
    if scenario.heats_from_s is not None:
        looks = [look for look in result.looks if look.time_s >= scenario.heats_from_s]
        assert looks
        assert [look.time_s for look in looks if not look.heater_pin] == []
        assert result.records[-1].link_up and result.records[-1].echo is not None


def check_history(result: ScenarioRun, scenario: Scenario) -> None:
    """Check that every expected event was reported, and no other alarm."""
    assert set(scenario.told) <= result.told()
    for key in scenario.conditions:
        begin, end = result.first(key), result.first(f"{key}.over")
        assert begin and end and begin.time_s < end.time_s
    assert set(scenario.alarms) <= result.told("alarm") <= {*scenario.alarms, *scenario.may_alarm}
    assert "board.refused" not in result.told(), "the daemon asked for what the board can't do"
    assert [record.seq for record in result.records] == list(range(1, len(result.records) + 1))


def check_valve(result: ScenarioRun) -> None:
    """No pulse twice; one that the line or a reset took away may be missing."""
    pulses = sum(record.sent.valve_pulse_s > 0.0 for record in result.records)
    assert pulses >= 2
    assert 0.0 < result.water_given_s() <= result.water_ordered_s() + PULSE_STEP_S * pulses
