"""Figures of a run, by numbers that were worked out by hand, and their means over seeds."""

import math
from collections import Counter

import numpy as np
import pytest

from training.control.closed_loop import ClosedLoopLog
from training.control.figures import Mean, before_k, cycles, figures, left_k, mean_of, overshoot_k, ratio


def log(**columns: list[float]) -> ClosedLoopLog:
    """Four ticks, a minute apart: the air is 1 K below, 0.5 K above, right."""
    rows = {
        "time_s": [0.0, 60.0, 120.0, 180.0],
        "reference_c": [25.0, 25.0, 25.0, 25.0],
        "true_air_c": [21.0, 24.0, 25.5, 25.0],
        "temp_air_c": [21.4, 24.4, np.nan, 25.4],
        "sensor_air_c": [21.0, 24.0, 25.0, 24.6],
        "heater_duty": [1.0, 0.5, 0.0, 1.0],
        "fan_on": [0.0, 1.0, 0.0, 0.0],
        "solve_ms": [1.0, 2.0, 3.0, 4.0],
    } | columns
    counted = Counter({"fan.min_on": 2}), Counter({"controller.late": 1})
    return ClosedLoopLog(
        {key: np.array(values) for key, values in rows.items()}, *counted, 0, asked=Counter(sent=7)
    )


def test_errors_are_of_the_end_of_each_step():
    found = figures(log())
    assert found.mae_true == pytest.approx((1.0 + 0.5 + 0.0) / 3)
    assert found.rmse_true == pytest.approx(np.sqrt((1.0 + 0.25) / 3))
    assert found.mae_measured == pytest.approx((0.6 + 0.4) / 2)  # a missing reading is no error
    assert found.near_pct == pytest.approx(100.0 * 2 / 3)  # half a kelvin is still near


def test_a_command_counts_until_the_next_one():
    found = figures(log())
    assert found.energy_wh == pytest.approx(1.5 * 100.0 / 60.0)  # the last row's never acted
    assert found.fan_min == pytest.approx(1.0)
    assert found.switches == 2.0
    assert found.travel == pytest.approx(0.5 + 0.5 + 1.0)


def test_the_cost_is_the_papers():
    found = figures(log())
    assert found.cost_0 == pytest.approx(10.0 * (1.0 + 0.25))
    assert found.cost_1 == pytest.approx(found.cost_0 + 1.0 + 0.25 + 1.0)  # duty² and the fan
    assert found.sensor_cost_0 == pytest.approx(10.0 * (0.6**2 + 0.4**2))  # 0.4 K of bias is the sensor's


def test_what_was_counted_comes_through():
    found = figures(log())
    assert (found.interventions, found.fallbacks, found.tokens) == (2.0, 1.0, 7.0)


@pytest.mark.parametrize(
    ("air", "beyond"),
    [
        ([20.0, 20.0, 23.0, 22.5], 1.0),  # 22 asked for from row 1 on
        ([20.0, 20.0, 21.0, 21.9], 0.0),
        ([20.0, 23.0, 22.0, 22.0], 0.0),  # what was before the step is not its overshoot
    ],
)
def test_overshoot_is_what_lies_beyond_the_new_reference(air, beyond):
    assert overshoot_k(np.array([20.0, 22.0, 22.0, 22.0]), np.array(air)) == pytest.approx(beyond)


def test_overshoot_after_a_step_down_lies_below():
    reference, air = np.array([24.0, 22.0, 22.0]), np.array([24.0, 24.0, 20.5])
    assert overshoot_k(reference, air) == pytest.approx(1.5)


def test_the_air_is_early_as_far_as_it_left_the_reference_towards_a_coming_step():
    reference = np.repeat([20.0, 25.0, 22.0], 20)
    error = np.zeros(59)
    error[15:20] = [0.1, -0.2, 0.2, 0.5, 0.3]  # 25 is due after these
    assert before_k(reference, error) == pytest.approx(0.5)
    error[36:40] = [3.0, 2.0, 1.0, 0.0]  # on its way back, and not towards 22
    assert before_k(reference, error) == pytest.approx(0.5)
    error[39] = -0.8
    assert before_k(reference, error) == pytest.approx(0.8)


def test_a_fan_that_starts_again_soon_after_heat_is_a_cycle():
    fan = np.zeros(40)
    fan[[0, 5, 20, 21]] = [0.5, 1.0, 0.25, 0.25]
    still, stepped = np.full(40, 25.0), np.where(np.arange(40) < 24, 25.0, 28.0)
    assert cycles(np.full(40, 0.4), fan, still) == 0
    assert cycles(np.ones(40), fan, still) == 2  # 15 steps between the second and the third
    assert cycles(np.ones(40), fan, stepped) == 1  # the step asks for the last


def test_only_air_that_goes_away_from_the_reference_has_left_it():
    assert left_k(np.array([2.0, 1.5, 1.0, 0.5])) == 0.0  # on its way back
    assert left_k(np.array([-1.0, -0.2, 0.3])) == pytest.approx(0.3)
    assert left_k(np.array([1.0, 0.2, 0.1, 0.7])) == pytest.approx(0.6)


def test_a_ramp_is_no_step():
    assert overshoot_k(np.array([20.0, 20.5, 21.0]), np.array([20.0, 25.0, 25.0])) == 0.0


def test_the_interval_is_students():
    found = mean_of([1.0, 2.0, 3.0])
    assert found.value == 2.0
    assert found.half == pytest.approx(4.3027 / math.sqrt(3.0), rel=1e-4)  # t(2, 0.975), sd 1


def test_one_seed_says_nothing_of_the_spread():
    assert mean_of([1.0]) == Mean(1.0, math.inf, 1)


def test_no_seed_is_an_error():
    with pytest.raises(ValueError, match="no values"):
        mean_of([])


def test_seeds_are_paired():
    assert ratio([1.0, 3.0], [0.5, 1.5]) == Mean(2.0, 0.0, 2)
