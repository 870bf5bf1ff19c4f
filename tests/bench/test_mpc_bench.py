"""bench/mpc.py: planning problems of plausible boxes."""

import numpy as np
import pytest

from bench.mpc import random_problems

MANY = list(random_problems(50, 120, 0.0, seed=1))


def test_the_same_seed_gives_the_same_plants():
    again = random_problems(50, 120, 0.0, seed=1)
    assert all(np.array_equal(one.heater, two.heater) for one, two in zip(MANY, again, strict=True))
    assert len({float(one.heater[-1]) for one in MANY}) == len(MANY)


def test_heat_warms_and_the_fan_cools():
    for problem in MANY:
        assert (problem.heater >= 0.0).all() and problem.heater.sum() > 0.0
        assert (problem.fan <= 0.0).all() and problem.fan.sum() < 0.0


def test_full_heat_approaches_the_rise_that_was_drawn():
    """After ten air time constants; the ranges' ends bound every plant's rise."""
    for problem in random_problems(20, 700, 0.0, seed=2):
        assert 9.9 < problem.heater.sum() <= 45.0 + 1e-9


def test_a_box_left_alone_ends_at_the_room():
    for problem in random_problems(20, 700, 0.0, seed=2):
        assert 14.9 < problem.free[-1] < 28.1


@pytest.mark.parametrize("horizon", [5, 30])
def test_a_longer_horizon_is_the_same_plant(horizon):
    short = next(random_problems(1, horizon, 0.0, seed=1))
    assert np.allclose(short.free, MANY[0].free[:horizon])
