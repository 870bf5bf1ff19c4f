"""edge/twin/filter.py: numbers by hand, and many states as one each."""

import numpy as np
import pytest

from edge.twin.filter import expectation, predict, symmetric, update, update_many, weigh

RNG = np.random.default_rng(2)


def states(*shape: int, size: int = 3) -> tuple[np.ndarray, np.ndarray]:
    root = RNG.normal(size=(*shape, size, size))
    return RNG.normal(size=(*shape, size)), root @ root.swapaxes(-1, -2)


def test_one_number_by_hand():
    # The state halves in a step: 4 / 2² + 1 = 2. A reading as good as the state (2 K²) counts half.
    covariance = predict(np.array([[4.0]]), np.array([[0.5]]), np.array([[1.0]]))
    assert covariance == 2.0
    assert expectation(np.array([10.0]), covariance, 12.0, 2.0) == (2.0, 4.0)
    mean, covariance = update(np.array([10.0]), covariance, 12.0, 2.0)
    assert (mean, covariance) == (11.0, 1.0)


def test_a_level_that_never_moves_ends_at_the_mean_of_its_readings():
    readings = [3.0, 5.0, 10.0]
    mean, covariance = np.array([0.0]), np.array([[1e12]])
    for reading in readings:
        mean, covariance = update(mean, predict(covariance, np.eye(1), np.zeros((1, 1))), reading, 6.0)
    assert mean[0] == pytest.approx(6.0)
    assert covariance[0, 0] == pytest.approx(2.0)  # 6 / 3


def test_what_goes_with_the_state_shown_is_learnt_with_it():
    # Gain (1, 3) / (3 + 1) of an innovation of 4; left of the covariance 3 - 9 / 4, 1 - 3 / 4 and 2 - 1 / 4.
    mean, covariance = update(np.zeros(2), np.array([[2.0, 1.0], [1.0, 3.0]]), 4.0, 1.0, shown=1)
    np.testing.assert_array_equal(mean, [1.0, 3.0])
    np.testing.assert_array_equal(covariance, [[1.75, 0.25], [0.25, 0.75]])


@pytest.mark.parametrize("missing", [np.nan, np.inf, -np.inf])
def test_without_a_reading_there_is_only_the_prediction(missing):
    mean, covariance = states()
    after = update(mean, covariance, missing, 0.1)
    np.testing.assert_array_equal(after[0], mean)
    np.testing.assert_array_equal(after[1], covariance)


def test_many_states_are_corrected_as_each_alone():
    mean, covariance = states(2, 4)
    measured = np.array([0.3, np.nan, -2.0, 1.0])
    found = weigh(mean, covariance, measured, 0.1)
    better, after = update_many(mean, covariance, found)
    for place in np.ndindex(2, 4):
        reading = measured[place[1]]
        alone = update(mean[place], covariance[place], reading, 0.1)
        np.testing.assert_array_equal(better[place], alone[0])
        np.testing.assert_array_equal(after[place], alone[1])
        innovation, variance = expectation(mean[place], covariance[place], reading, 0.1)
        np.testing.assert_array_equal(found.innovation[place], innovation)
        assert found.variance[place] == variance
    matrix, noise = RNG.normal(size=(4, 3, 3)), np.eye(3)
    many = predict(covariance, matrix, noise)
    for place in np.ndindex(2, 4):
        np.testing.assert_allclose(many[place], predict(covariance[place], matrix[place[1]], noise))


def test_the_covariance_is_that_of_the_estimate_and_symmetric():
    mean, covariance = states()
    gain = covariance[:, 0] / (covariance[0, 0] + 0.1)
    kept = np.eye(3) - np.outer(gain, np.eye(3)[0])
    _, after = update(mean, covariance, 1.0, 0.1)
    # Joseph's form holds for any gain: what is kept of the old error, and the reading's.
    np.testing.assert_allclose(after, kept @ covariance @ kept.T + 0.1 * np.outer(gain, gain), atol=1e-12)
    after = symmetric(after + 1e-14 * np.triu(np.ones((3, 3)), 1))
    np.testing.assert_array_equal(after, after.T)


def test_a_wild_reading_teaches_the_last_state_no_more_than_three_deviations():
    mean, covariance = (
        np.zeros(2),
        np.array([[3.0, 2.0], [2.0, 5.0]]),
    )  # sd of the innovation 2, gain (3, 2) / 4
    np.testing.assert_allclose(update(mean, covariance, -40.0, 1.0, clip_sd=3.0)[0], [-30.0, -3.0])
    np.testing.assert_allclose(update(mean, covariance, 6.0, 1.0, clip_sd=3.0)[0], [4.5, 3.0])


def test_where_nothing_is_uncertain_nothing_is_learnt():
    mean, covariance = update(np.ones(2), np.zeros((2, 2)), 5.0, 0.0)
    np.testing.assert_array_equal(mean, [1.0, 1.0])
    np.testing.assert_array_equal(covariance, np.zeros((2, 2)))
