"""Two hours of the whole daemon on the virtual board: the controllers hold what they are asked for.

Bounds of the error are two to four times what was measured. The full day: bench/closed_loop_day.py.
"""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from bench.closed_loop_day import Day, run_day, table_line
from bench.closed_loop_picture import draw

HOURS = 2.0
WARM_THEN_COOL = """
timezone: UTC
reference:
  kind: steps
  steps: [{at_s: 0, reference_c: 27}, {at_s: 3600, reference_c: 24}]
"""


@pytest.fixture(scope="module")
def days() -> dict[str, Day]:
    return {
        name: run_day(name, seed=1, hours=HOURS, yaml=WARM_THEN_COOL) for name in ("MPC", "MPC-P", "rules")
    }


def settled_mae_k(day: Day) -> float:
    measured, _ = day.errors
    return float(np.nanmean(np.abs(measured[day.settled])))


def test_both_planners_hold_the_reference_better_than_the_thermostat(days):
    assert settled_mae_k(days["MPC-P"]) < 0.2
    assert settled_mae_k(days["MPC"]) < 0.4
    for name in ("MPC", "MPC-P"):
        assert settled_mae_k(days[name]) < settled_mae_k(days["rules"])


def test_no_controller_overheats_the_box(days):
    for day in days.values():
        assert np.nanmax(day.columns["temp_air_c"]) < 27.0 + 4.0  # the thermostat's overshoot, from 29.6


def test_the_planner_with_penalty_has_no_steady_state_error(days):
    measured, _ = days["MPC-P"].errors
    assert abs(np.nanmean(measured[days["MPC-P"].settled])) < 0.05


def test_the_penalty_saves_effort(days):
    def effort(day: Day) -> float:  # as the penalty counts it
        return float((day.columns["heater_duty"] ** 2).sum() + day.columns["fan_on"].sum())

    assert effort(days["MPC-P"]) < effort(days["MPC"])


def test_every_minute_has_its_tick_and_the_heater_is_off_at_the_end(days):
    for day in days.values():
        assert len(day.columns["time_s"]) == HOURS * 60
        np.testing.assert_allclose(np.diff(day.columns["time_s"]), 60.0, atol=0.01)
        assert day.heater_off_at_end


def test_safety_changes_nothing_of_a_quiet_run(days):
    for day in days.values():
        assert not day.changes, table_line(day)


def test_the_picture_of_a_day_is_drawn_with_and_without_plans(tmp_path: Path) -> None:
    hours = np.arange(0.0, 6.0, 1.0 / 60.0)
    reference = np.where((hours > 2.0) & (hours < 4.0), 28.0, 24.0)
    columns = {
        "time_s": 3600.0 * hours,
        "reference_c": reference,
        "temp_air_c": reference + 0.1,
        "temp_ambient_c": np.full(len(hours), 21.0),
        "heater_duty": np.full(len(hours), 0.2),
        "fan_on": np.zeros(len(hours)),
    }
    sizes = []
    for plans in ((), ((25.0, 26.0, 27.0),) * len(hours)):
        draw(Day("MPC-P", 1, columns, Counter(), 0, True, plans), tmp_path / "day.png")
        sizes.append((tmp_path / "day.png").stat().st_size)
    assert 0 < sizes[0] < sizes[1]  # the plans are ink
