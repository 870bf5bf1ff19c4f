"""edge/twin/filter.py: numbers by hand, many states as one each, and the diagnosis' own form of it."""

import numpy as np
import pytest

from edge.diagnosis.innovations import FilterInput, NoiseLevels, gains, whiten
from edge.twin.filter import expectation, predict, symmetric, update, update_many, weigh
from edge.twin.linearise import linearise
from edge.twin.model import BoxTwin
from edge.twin.run_batch import RunBatch
from edge.twin.warm_start import spread

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


def test_the_diagnosis_filter_of_many_twins_is_this_one():
    twin = BoxTwin(effects={"heater_lag": {"tau_h": 120.0}, "sensor_lag": {"tau_s": 45.0}})
    rows, levels = 30, NoiseLevels(sensor_k=0.15, room_k=0.3, heat_w=3.0, heat_tau_s=400.0, power_share=0.1)
    duty, fan = RNG.random((1, rows)), RNG.integers(0, 2, (1, rows)).astype(float)
    runs = RunBatch(np.full((1, rows + 1), 22.0), duty, fan, np.full((1, rows), 21.0))
    steps, errors = linearise(twin, runs), RNG.normal(size=rows)
    seen = RNG.random((1, rows)) > 0.2
    filters = gains([FilterInput(steps, levels, spread(twin), twin.step_s)], seen)
    white = whiten(filters, np.array([0]), errors[None, None])[0, 0]

    kept, size = np.exp(-twin.step_s / levels.heat_tau_s), len(twin.states)
    mean = np.zeros(size + 2)  # the twin's states, the unknown heat and the power's share
    covariance = np.diag([*spread(twin), levels.heat_w, levels.power_share]) ** 2
    for k in range(rows):
        matrix = np.diag([*np.zeros(size), kept, 1.0])
        matrix[:size, :size] = steps.table[steps.index[k, 0]]
        matrix[:size, size], matrix[:size, size + 1] = steps.heat[k, 0], steps.duty[k, 0]
        room = np.append(levels.room_k * steps.room[k, 0], [0.0, 0.0])
        noise = np.outer(room, room)
        noise[size, size] += levels.heat_w**2 * (1.0 - kept**2)
        mean, covariance = matrix @ mean, predict(covariance, matrix, noise)
        reading = errors[k] if seen[0, k] else np.nan
        innovation, variance = expectation(mean, covariance, reading, levels.sensor_k**2)
        assert filters.sd[k, 0, 0] == pytest.approx(np.sqrt(variance), rel=1e-9)
        assert white[k] == pytest.approx(np.nan_to_num(innovation / np.sqrt(variance)), abs=1e-9)
        mean, covariance = update(mean, covariance, reading, levels.sensor_k**2)
