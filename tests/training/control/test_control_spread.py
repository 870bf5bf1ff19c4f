"""Means over seeds, and when two controllers are told apart."""

import math

import pytest

from training.control.spread import Mean, difference, mean_of, ratio, told_apart


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
    assert difference([1.0, 2.0], [0.5, 1.5]) == Mean(0.5, 0.0, 2)
    assert ratio([1.0, 3.0], [0.5, 1.5]) == Mean(2.0, 0.0, 2)


@pytest.mark.parametrize(
    ("mean", "verdict"),
    [
        (Mean(-0.6, 0.1, 5), "better"),
        (Mean(0.6, 0.1, 5), "worse"),
        (Mean(0.5, 0.1, 5), "undecided"),  # the sensor's class is not beaten by its own edge
        (Mean(0.6, 0.7, 5), "undecided"),  # the seeds do not agree
        (Mean(math.nan, 0.1, 5), "undecided"),
        (Mean(0.6, math.inf, 1), "undecided"),
    ],
)
def test_controllers_are_told_apart_beyond_sensor_and_seeds(mean, verdict):
    assert told_apart(mean) == verdict
