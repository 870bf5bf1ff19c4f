"""edge/drift/evidence.py, noise.py, where.py: the sequential test, what it learns, whom it blames."""

import numpy as np
import pytest

from bench.drift_alarms import STEP_S, Colour, simulate
from edge.drift import evidence, noise, where
from edge.drift.evidence import ALLOWED, CUT, Evidence
from edge.drift.monitor import Promise
from edge.drift.regimes import CELLS, REGIMES, situation

pytestmark = pytest.mark.slow

ALL = np.ones(len(REGIMES), dtype=bool)
NAMES = [regime.name for regime in REGIMES]
THRESHOLD = evidence.log_threshold(90.0, 60.0)


def only(*names: str) -> np.ndarray:
    return np.array([name in names for name in NAMES])


# what the promise of few false alarms rests on


@pytest.mark.parametrize("mean", [0.0, ALLOWED, -ALLOWED, ALLOWED / 2])
def test_no_likelihood_ratio_grows_in_the_mean_while_the_mean_is_allowed(mean):
    # E[L] <= 1, by quadrature over a normal innovation of variance 1: 8 sd either side, 160 points a sd
    z = np.linspace(-8.0, 8.0, 2561)
    density = np.exp(-(z**2) / 2.0) / np.sqrt(2.0 * np.pi) * (z[1] - z[0])
    grown = [_ratio(value) for value in np.clip(z + mean, -CUT, CUT)]
    assert (np.tensordot(density, np.array(grown), 1) <= 1.0 + 1e-6).all()


def _ratio(white: float) -> np.ndarray:
    """L of each size, as `hear` multiplies by it: from R = 0, R becomes L."""
    found = evidence.hear(Evidence.none(0.0), np.asarray(white), ALL, 0.0, THRESHOLD)
    return np.exp(found.log_sum[0])


def test_the_threshold_is_the_number_of_ticks_in_the_days_promised():
    # 90 days of minutes
    assert np.exp(evidence.log_threshold(90.0, 60.0)) == pytest.approx(129_600)


@pytest.mark.parametrize("colour", [Colour("white"), Colour("10 min", phi=0.9), Colour("t", degrees=4.0)])
def test_false_alarms_are_fewer_than_promised(colour):
    # 60 rigs, 2 days each, one alarm a day promised at most: 120 would be allowed on average. The promise is
    # a bound for the worst that is allowed, so ordinary noise keeps far below it: a tenth is asked for here.
    alarms = simulate(colour, paths=60, days=2.0, promise=Promise(STEP_S, false_alarm_days=1.0, learn_h=3.0))
    assert alarms.count <= 12


def test_noise_that_the_test_cannot_allow_does_alarm():
    # the same rigs, the mean of whose innovations is one stated sd off for the second half
    promise = Promise(STEP_S, false_alarm_days=1.0, learn_h=3.0)
    assert simulate(Colour("white"), 60, 2.0, promise, shift=1.0, at=1440).count > 60


def test_a_shift_of_half_a_kelvin_a_step_is_seen_within_20_minutes_and_dated_to_5():
    # the packaged twin's innovations have a stated sd of 0.22 K with the fan off: 0.5 K are 2.3 of them
    begin = 1440
    alarms = simulate(
        Colour("white"), 40, 1.1, Promise(STEP_S, 90.0, learn_h=4.0), shift=0.5 / 0.22, at=begin
    )
    assert len(alarms.first) == 40
    assert (alarms.first >= begin).all()
    assert np.percentile(alarms.first - begin, 90) <= 20
    assert np.percentile(np.abs(alarms.change - begin), 90) <= 5


def test_the_wildest_ticks_take_ten_minutes_to_raise_an_alarm():
    found, ticks = Evidence.none(0.0), 0
    while found.total < THRESHOLD:
        found, ticks = evidence.hear(found, np.asarray(1e9), ALL, 60.0 * ticks, THRESHOLD), ticks + 1
    assert ticks == 9  # the door open for eight minutes is none


def test_a_regime_that_is_not_there_neither_gathers_nor_loses_evidence():
    one = evidence.hear(Evidence.none(0.0), np.asarray(2.0), only("all", "fan_on"), 0.0, THRESHOLD)
    two = evidence.hear(one, np.asarray(-2.0), only("all", "fan_off"), 60.0, THRESHOLD)
    fan_on = NAMES.index("fan_on")
    np.testing.assert_array_equal(one.cusum[fan_on], two.cusum[fan_on])
    np.testing.assert_array_equal(one.log_sum[fan_on], two.log_sum[fan_on])


def test_the_change_is_dated_to_the_last_time_without_evidence():
    found = Evidence.none(0.0)
    for k in range(60):
        white = np.asarray(2.0 if k >= 40 else 0.0)
        found = evidence.hear(found, white, ALL, 60.0 * k, THRESHOLD)
    assert evidence.change_utc(found) == 60.0 * 40


# what is learnt


def learn(z: np.ndarray, cell: int = 0) -> np.ndarray:
    sums, past = noise.nothing_learnt(), noise.InnovationPast(np.asarray(0.0), np.asarray(0.0))
    for value in z:
        sums = noise.learnt(sums, cell, np.asarray(value), past)
        past = noise.follow(past, np.asarray(value), 60.0)
    return sums


def test_the_colour_that_was_put_in_is_learnt():
    # z = 0.2 + 0.6 z' + 0.8 e: 4000 ticks give phi to about sqrt(1 - 0.36) / sqrt(4000) = 0.013
    random = np.random.default_rng(1)
    z = np.zeros(4000)
    for k in range(1, len(z)):
        z[k] = 0.2 + 0.6 * z[k - 1] + 0.8 * random.standard_normal()
    bias, last, mean, scale = noise.weights(learn(z), 0)
    assert 1.0 / scale == pytest.approx(noise.WIDENED * 0.8, rel=0.05)
    assert -(last + mean) / scale == pytest.approx(0.6, abs=0.06)
    assert -bias / scale == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize("size", [0.0, 1e-9, 100.0])
def test_what_is_learnt_stays_within_its_bounds(size):
    scale = 1.0 / noise.weights(learn(size * np.random.default_rng(2).standard_normal(500)), 0)[3]
    assert noise.SCALE_MIN <= scale <= noise.SCALE_MAX


def test_a_twin_that_was_wrong_from_the_first_tick_is_not_learnt_to_be_right():
    # innovations of 6 stated sd with a chance of half of one: the bias that is believed is 0.5
    known = noise.weights(learn(6.0 + 0.5 * np.random.default_rng(3).standard_normal(1000)), 0)
    assert -known[0] / known[3] <= noise.BIAS_MAX


def test_cells_are_learnt_one_by_one():
    sums = learn(np.ones(10), cell=2)
    assert [noise.count(sums, cell) for cell in range(CELLS)] == [0, 0, 10, 0]
    assert noise.share_learnt(sums, 20) == 0.5  # of the one cell that was visited


# whom it blames


def table_of(ticks: list[tuple[float, np.ndarray]]) -> tuple[np.ndarray, Evidence]:
    table, found = where.empty(), Evidence.none(0.0)
    for white, regimes in ticks:
        table = where.note(table, white, 0.1 * white, regimes, 60.0)
        found = evidence.hear(found, np.asarray(white), regimes, 0.0, THRESHOLD)
    return table, found


def blamed(ticks: list[tuple[float, np.ndarray]]) -> str:
    table, found = table_of(ticks)
    return NAMES[where.worst(table, evidence.by_regime(found))]


def test_the_regime_in_which_it_errs_is_blamed():
    on, off = only("all", "fan_on", "heater_off"), only("all", "fan_off", "heater_off")
    assert blamed([(2.0, on), (0.1, off)] * 30) == "fan_on"


def test_errors_at_all_times_are_blamed_on_no_part_of_them():
    on, off = only("all", "fan_on"), only("all", "fan_off")
    assert blamed([(1.5, on), (1.6, off), (1.6, on), (1.5, off)] * 15) == "all"


def test_without_a_tick_nobody_is_blamed():
    assert blamed([]) == "all"


def test_the_table_tells_shares_and_errors():
    on, off = only("all", "fan_on"), only("all", "fan_off")
    rows = where.rows(table_of([(2.0, on), (1.0, off)])[0])
    # squares 4 and 1, forgetting within a minute aside
    assert rows[NAMES.index("fan_on")].share_of_squares == pytest.approx(0.8, abs=0.01)
    assert rows[NAMES.index("fan_off")].error_k == pytest.approx(0.1)
    assert rows[NAMES.index("heater_on")].ticks == 0.0


# regimes


def regimes_of(duty: list[float], fan: list[float], lift_k: float = 0.0) -> set[str]:
    count = len(duty)
    columns = {
        "heater_duty": np.array(duty),
        "fan_on": np.array(fan),
        "temp_air": np.full(count, 21.0 + lift_k),
        "temp_ambient": np.full(count, 21.0),
    }
    return {name for name, holds in zip(NAMES, situation(columns, 60.0).regimes, strict=True) if holds}


@pytest.mark.parametrize(
    ("duty", "fan", "lift_k", "expected"),
    [
        ([0.0, 0.0], [0.0, 0.0], 0.0, {"all", "fan_off", "heater_off"}),
        ([0.5, 0.0], [1.0, 0.0], 0.0, {"all", "fan_on", "heater_on", "heater_strong"}),
        ([0.45, 1.0], [1.0, 0.0], 6.0, {"all", "fan_on", "heater_on"}),
        ([0.0, 0.0], [0.0, 0.0], 6.01, {"all", "fan_off", "heater_off", "warm_box"}),
        ([0.0, 0.2, 0.0], [0.0, 1.0, 0.0], 0.0,
         {"all", "fan_on", "heater_on", "heater_raised", "fan_started"}),
        ([0.2, 0.0, 0.0], [1.0, 0.0, 0.0], 0.0,
         {"all", "fan_off", "heater_off", "heater_lowered", "fan_stopped"}),
        ([np.nan, np.nan], [np.nan, np.nan], np.nan, {"all", "fan_off", "heater_off"}),
        ([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [0.0] * 8, 0.0, {"all", "fan_off", "heater_off"}),
    ],
)  # fmt: skip
def test_the_regimes_of_a_step_are_those_of_its_begin(duty, fan, lift_k, expected):
    assert regimes_of(duty, fan, lift_k) == expected


@pytest.mark.parametrize(
    ("duty", "fan", "cell"), [(0.0, 0.0, 0), (0.0, 1.0, 1), (0.05, 0.0, 2), (1.0, 1.0, 3)]
)
def test_heater_and_fan_make_four_cells(duty, fan, cell):
    columns = {"heater_duty": np.full(2, duty), "fan_on": np.full(2, fan), "temp_air": np.full(2, 20.0),
               "temp_ambient": np.full(2, 20.0)}  # fmt: skip
    assert situation(columns, 60.0).cell == cell
