"""MAE at equal energy and energy at equal MAE, from made-up runs."""

from dataclasses import replace

import numpy as np
import pytest

from training.control.compare import OURS, at_most, energy_picture, energy_table, energy_tables
from training.control.comparison import RunResult
from training.control.figures import Figures

ZERO = Figures(*[0.0] * 16)
CURVE = np.array([110.0, 100.0, 80.0, 60.0, 50.0, 40.0]), np.array([0.3, 0.2, 1.0, 2.0, 2.5, 3.0])  # Wh, K


def made(entry: str, seed: int, energy: float, mae: float) -> RunResult:
    return RunResult(entry, "reference_1", seed, replace(ZERO, energy_wh=energy, mae_true=mae))


def ours(seed: int) -> list[RunResult]:
    return [made(name, seed, *point) for name, *point in zip(OURS, *CURVE, strict=True)]


@pytest.mark.parametrize(
    ("limit", "expected"), [(40.0, 3.0), (50.0, 2.5), (100.0, 0.2), (105.0, 0.2), (110.0, 0.2), (500.0, 0.2)]
)
def test_the_curve_gives_the_best_with_no_more_energy(limit, expected):
    assert at_most(limit, *CURVE) == pytest.approx(expected)


def test_the_curve_gives_the_least_energy_for_a_mae():
    energy, mae = CURVE
    assert at_most(1.5, mae, energy) == pytest.approx(70.0)
    assert at_most(9.0, mae, energy) == 40.0


@pytest.mark.parametrize("limit", [39.9, -1.0, float("nan")])
def test_below_the_curve_is_nothing(limit):
    assert np.isnan(at_most(limit, *CURVE))


def test_a_controller_stands_beside_ours_seed_by_seed():
    results = [*ours(1), *ours(2), *(made("RL-Off", seed, 90.0, 1.5) for seed in (1, 2, 3))]
    table = energy_table(results, ["RL-Off", "clairvoyant"], "reference_1")
    assert table.rows == (("RL-Off", "90", "1.500", "0.600", "0.900", "70", "20"),)


def test_a_mae_is_by_the_true_air_and_by_the_sensor():
    def by_sensor(one):
        return replace(one, figures=replace(one.figures, mae_measured=one.figures.mae_true / 2.0))

    results = [by_sensor(one) for one in (*ours(1), made("RL-Off", 1, 90.0, 1.5))]
    true, sensor = energy_tables(results, ["RL-Off"], "reference_1")
    assert true.rows == (("RL-Off", "90", "1.500", "0.600", "0.900", "70", "20"),)
    assert sensor.rows == (("RL-Off", "90", "0.750", "0.300", "0.450", "70", "20"),)
    assert (true.title != sensor.title, energy_tables([], ["RL-Off"], "reference_1")) == (True, [])


def test_less_than_ours_can_is_a_dash():
    table = energy_table([*ours(1), made("PID", 1, 30.0, 0.1)], ["PID"], "reference_1")
    assert table.rows == (("PID", "30", "0.100", "-", "-", "-", "-"),)


def test_without_ours_at_every_weight_there_is_no_table():
    assert energy_table([*ours(1)[1:], made("PID", 1, 30.0, 0.1)], ["PID"], "reference_1") is None
    assert energy_picture([made("PID", 1, 30.0, 0.1)], ["PID"], ["reference_1"]).startswith(b"\x89PNG")
