import json
import math

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.forecasts.conformal import (
    RATE,
    WIDTH_MAX_K,
    WIDTH_MIN_K,
    Interval,
    Intervals,
    half_width,
    read_intervals,
    track,
    write_intervals,
)

ROW = Interval("arx", "v1", 5, 0.25, 100, "interpolation")


def singles(*errors):
    return [np.array([error]) for error in errors]


@pytest.mark.parametrize("runs", [9, 10, 19, 20, 99, 100])
def test_with_one_error_a_run_it_is_the_usual_split_conformal_quantile(runs):
    # the ceil((n + 1) 0.9)-th smallest of 1, 2, .., n
    errors = np.random.default_rng(1).permutation(np.arange(1.0, runs + 1.0))
    assert half_width(singles(*errors)) == math.ceil((runs + 1) * 0.9 - 1e-9)


@pytest.mark.parametrize("runs", [0, 1, 8])
def test_too_few_runs_for_the_claim_give_no_finite_interval(runs):
    assert half_width(singles(*range(runs))) == math.inf


def test_a_run_weighs_the_same_whatever_its_length():
    # 19 short runs with an error of 1 and a long one with 2: 19/20 of the runs are at 1
    errors = [np.ones(3)] * 19 + [np.full(1000, 2.0)]
    assert half_width(errors) == 1.0
    assert half_width([np.ones(3)] * 17 + [np.full(1000, 2.0)] * 3) == 2.0


def test_the_sign_of_an_error_does_not_matter_and_empty_runs_do_not_count():
    assert half_width([*singles(*([-1.0] * 9)), np.array([])]) == 1.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_an_error_that_is_no_number_is_refused(bad):
    with pytest.raises(DataError, match="not a number"):
        half_width(singles(1.0, bad))


def test_new_runs_are_covered_as_claimed_though_errors_within_a_run_hang_together():
    # each run has its own scale: 400 calibrations on 50 runs of 30, tested on 200 new ones. The mean coverage
    # is at least 0.9, and at most 1/51 more.
    rng = np.random.default_rng(7)

    def runs(count):
        return rng.lognormal(0.0, 0.7, (count, 1)) * np.abs(rng.standard_normal((count, 30)))

    seen = [np.mean(runs(200) <= half_width(list(runs(50)))) for _ in range(400)]
    assert 0.9 - 0.004 <= np.mean(seen) <= 0.9 + 1 / 51 + 0.004  # 0.004: four standard errors


# the table


def test_the_table_reads_back(tmp_path):
    table = Intervals((ROW,), {"command": "x"})
    write_intervals(table, tmp_path / "intervals.json")
    back = read_intervals(tmp_path / "intervals.json")
    assert back == table
    assert back.half_width("arx", "v1", 5) == 0.25


@pytest.mark.parametrize("key", [("pbm", "v1", 5), ("arx", "v2", 5), ("arx", "v1", 6)])
def test_what_was_not_calibrated_has_no_interval(key):
    assert Intervals((ROW,)).half_width(*key) is None


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"format": 2}, "format"),
        ({"claimed": 0.8}, "claimed"),
        *(({"half_width_k": value}, r"intervals\[0\]\.half_width_k") for value in (0.0, -1.0)),
    ],
)
def test_a_wrong_table_is_refused_by_file_and_key(tmp_path, change, named):
    path = tmp_path / "intervals.json"
    write_intervals(Intervals((ROW,)), path)
    document = json.loads(path.read_text())
    in_row = change.keys() <= document["intervals"][0].keys()
    (document["intervals"][0] if in_row else document).update(change)
    path.write_text(json.dumps(document))
    with pytest.raises(DataError, match=rf"intervals\.json: {named}"):
        read_intervals(path)


# adaptive


@pytest.mark.parametrize(
    ("residual_k", "wider"), [(1.0, False), (-1.0, False), (1.001, True), (-1.001, True)]
)
def test_a_miss_widens_and_a_hit_narrows_a_ninth_as_much(residual_k, wider):
    step = math.log(track(1.0, residual_k))
    assert step == pytest.approx(0.9 * RATE if wider else -0.1 * RATE)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_no_number_teaches_nothing(bad):
    assert track(1.0, bad) == 1.0


def test_the_width_stays_within_its_bounds():
    assert track(WIDTH_MIN_K, 0.0) == WIDTH_MIN_K
    assert track(WIDTH_MAX_K, 1e9) == WIDTH_MAX_K


def test_the_share_held_comes_to_the_claim_when_the_errors_are_three_times_larger():
    # errors of 3 K against a calibration of 1 K; the bound of the docstring after 5000 is 0.016
    errors = np.random.default_rng(3).normal(0.0, 3.0, 5000)
    width, held = 1.0, 0
    for error in errors:
        held += abs(error) <= width
        width = track(width, float(error))
    assert abs(held / 5000 - 0.9) <= abs(math.log(width)) / (RATE * 5000) + 1e-9 < 0.02
