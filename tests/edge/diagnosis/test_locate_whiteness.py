import numpy as np
import pytest
from locate_runs import BASE, located, made, whiteness_of

from edge.diagnosis.location import whiteness


def holes(values, rng):
    values = values.copy()
    values[rng.uniform(size=len(values)) < 0.3] = np.nan
    values[60:100] = np.nan
    return values


@pytest.mark.parametrize("gaps", [False, True])
def test_p_values_of_white_noise_are_spread_evenly(gaps):
    rng = np.random.default_rng(0)
    found = []
    for _ in range(200):
        values = rng.normal(size=200)
        found.append(whiteness(holes(values, rng) if gaps else values, 60.0))
    for share in (0.05, 0.5):  # within 3.5 binomial standard deviations of 200 draws
        margin = 3.5 * np.sqrt(share * (1.0 - share) / 200.0)
        assert np.mean([w.ljung_box_p < share for w in found]) == pytest.approx(share, abs=margin)
        assert np.mean([w.false_alarm < share for w in found]) < share + margin


def test_ljung_box_statistic_by_its_formula():
    values = np.random.default_rng(1).normal(size=50)
    off = values - values.mean()
    r = np.array([(off[k:] * off[:-k]).sum() / (off**2).sum() for k in range(1, 11)])
    found = whiteness(values, 60.0)
    assert found.lags == 10  # a fifth of the rows
    # n (n + 2) sum r_k^2 / (n - k), Ljung & Box 1978 eq. 1.4
    assert found.statistic == pytest.approx(50 * 52 * (r**2 / (50 - np.arange(1, 11))).sum())


def test_a_first_order_process_is_not_white():
    rng, values = np.random.default_rng(2), [0.0]
    for _ in range(299):
        values.append(0.6 * values[-1] + rng.normal())
    found = whiteness(np.array(values), 60.0)
    assert found.ljung_box_p < 1e-6
    assert found.lag1_autocorrelation == pytest.approx(0.6, abs=0.12)


def test_a_hidden_period_is_found_among_noise_and_gaps():
    rng = np.random.default_rng(3)
    values = holes(rng.normal(size=300) + np.sin(2.0 * np.pi * np.arange(300) / 17.3), rng)
    found = whiteness(values, 60.0)
    assert found.strongest_period_s == pytest.approx(17.3 * 60.0, rel=0.02)
    assert found.false_alarm < 1e-4


@pytest.mark.parametrize(
    "values", [[], [0.1] * 19, [np.nan] * 50, [0.3] * 50, [0.1, *[np.nan] * 60]], ids=str
)
def test_too_few_rows_or_no_variation_say_nothing(values):
    found = whiteness(np.array(values, dtype=float), 60.0)
    assert found.ljung_box_p is found.lag1_autocorrelation is found.false_alarm is None


def test_a_right_twin_is_white_and_a_wrong_one_is_not():
    right = [whiteness_of(run) for run in located(made({**BASE}))]
    wrong = [whiteness_of(run) for run in located(made({**BASE, "wall_loss": {"UA": 8.0}}))]
    assert max(run.ljung_box_p for run in wrong) < 1e-6
    assert np.mean([run.lag1_autocorrelation for run in wrong]) > 0.3
    assert min(run.ljung_box_p for run in right) > 1e-4
    assert abs(np.mean([run.lag1_autocorrelation for run in right])) < 0.2
    assert {run.rows for run in right} == {180}
