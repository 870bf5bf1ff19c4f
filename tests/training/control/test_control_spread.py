"""Means over seeds, with their intervals."""

import math

import pytest

from training.control.figures import Mean, mean_of, ratio


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
