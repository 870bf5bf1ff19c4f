"""Every fault of the line, the board and the sensors: heater off in time, told, and control recovers.

On the board's core in Python or in C in turn, since the conformance tests hold them alike, and for two on a
program that is flashed, in simavr with simulated sensors. `make board-programs` runs every scenario, and two
hours, on both boards' programs.
"""

import os
from pathlib import Path

import pytest
from run import ScenarioRun, run
from scenario import FOLDER, Scenario, names, read

from tests.support.virtual_board import on_cores_in_turn

PULSE_STEP_S = 0.1  # the board looks at its valve this often
HEAT_BEGINS_S = 5.0  # ticks begin 1 s after the start
# A new rig waits for the soak time, then for the disk, whose answer is no matter of simulated time.
FIRST_PULSE_S = 240.0


FIRMWARE_TESTS = Path(__file__).parents[1] / "firmware_protocol"
PROGRAMS = {"uno": "avr.avr_core:uno", "mega2560": "avr.avr_core:mega2560"}
ON_PROGRAMS = {"sensor_without_a_number": "uno", "reset": "mega2560"}
# The simulated microcontroller's own clock cannot be made to drift or wrap, and it speaks one version.
NOT_ON_PROGRAMS = {"clock_drifts", "clock_wraps", "other_protocol"}
LONG = "two_hours"


def cases() -> list[tuple[str, str]]:
    """Pairs of a scenario and a core."""
    if os.environ.get("BOARD_PROGRAMS") == "all":
        return [(name, board) for name in names() if name not in NOT_ON_PROGRAMS for board in PROGRAMS]
    short = [name for name in names() if name != LONG]
    return on_cores_in_turn(short) + list(ON_PROGRAMS.items())


@pytest.mark.timeout(7200 if os.environ.get("BOARD_PROGRAMS") else 600)
@pytest.mark.parametrize(("name", "core"), cases())
def test_scenario(tmp_path, name, core, request, monkeypatch):
    if core in PROGRAMS:
        monkeypatch.setenv("AVR_HOST", str(request.getfixturevalue("avr_host")))
        monkeypatch.setenv(
            "PYTHONPATH", os.pathsep.join((str(FIRMWARE_TESTS), os.environ.get("PYTHONPATH", "")))
        )
    scenario = read(FOLDER / f"{name}.yaml")
    result = run(
        tmp_path,
        scenario.end_s,
        core=PROGRAMS.get(core, core),
        faults=scenario.faults,
        orders=scenario.given(),
        settings=scenario.settings,
        board=(*scenario.board, *(("--with", "heater_cutoff") if core in PROGRAMS else ())),
        chamber=scenario.chamber,
    )
    check_heat(result, scenario)
    check_history(result, scenario)
    check_valve(result, pulses_min=0 if scenario.end_s < FIRST_PULSE_S else 1)
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


def check_valve(result: ScenarioRun, pulses_min: int) -> None:
    """No pulse twice; one that the line or a reset took away may be missing."""
    pulses = sum(record.sent.valve_pulse_s > 0.0 for record in result.records)
    assert pulses >= pulses_min
    assert result.water_given_s() <= result.water_ordered_s() + PULSE_STEP_S * pulses
    assert result.water_given_s() > 0.0 or pulses_min == 0
