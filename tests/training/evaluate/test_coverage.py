"""Calibration and coverage: `python -m training.evaluate.coverage`, on runs short enough for a test."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from forecast_rig import RampPredictor

from edge.core.errors import DataError
from edge.forecasts.conformal import Interval, Intervals
from edge.formats.run_file import RecordedRun
from firmware_protocol.virtual_board.chamber import Chamber
from firmware_protocol.virtual_board.chamber_parameters import load
from firmware_protocol.virtual_board.profiles.generate import SequencePlan
from firmware_protocol.virtual_board.profiles.record import RecordedRow, record
from training.evaluate import coverage, fresh_runs
from training.evaluate.coverage import errors_of, errors_of_run

ROWS = [RecordedRow(60 * k, 0.35, int(k > 3)) for k in range(6)]
MINUTES = 70


def warming_run(drift_k=0.0, role="calibrate"):
    """A box that gains 0.02 K a minute more than Ramp() says, at no duty."""
    temps = 20.0 + drift_k * np.arange(MINUTES)
    nothing = np.zeros(MINUTES)
    columns = {
        "time_s": 60.0 * np.arange(MINUTES),
        "temp_air_c": temps,
        "heater_duty": nothing,
        "fan_on": nothing,
    }
    return RecordedRun(columns, {"role": role, "seed": "1"})


# fresh runs


def test_a_fresh_run_reads_as_the_recorder_does_up_to_the_sensors_noise():
    parameters, effects = load()
    recorded = record(Chamber(parameters, effects, 5), ROWS)
    for ours, theirs in zip(fresh_runs.measure(ROWS, 5), recorded, strict=True):
        assert ours["temp_air_c"] == pytest.approx(theirs["temp_air_c"], abs=0.25)  # 0.1 K steps, 5 s


def test_the_same_seed_gives_the_same_run_and_another_one_does_not():
    assert fresh_runs.measure(ROWS, 5) == fresh_runs.measure(ROWS, 5)
    assert fresh_runs.measure(ROWS, 5) != fresh_runs.measure(ROWS, 6)


def test_a_candidate_that_gets_too_hot_is_given_up_at_once():
    readings = fresh_runs.measure(ROWS, 5, stop_above_c=-50.0)
    assert len(readings) == 2


@pytest.mark.parametrize(
    ("kind", "role"), [("calibration", "calibrate"), ("interpolation", "test"), ("extrapolation", "test")]
)
def test_a_run_is_kept_and_read_again(tmp_path, monkeypatch, kind, role):
    small = SequencePlan(4, (0.5, 1.0), 0.0, 0.2, (1, 2), (10.0, 40.0))
    monkeypatch.setattr(fresh_runs, "PLANS", (small,))
    monkeypatch.setattr(fresh_runs, "HOTTER", small)
    seed = fresh_runs.FIRST_SEEDS[kind]
    fresh_runs.keep((kind, seed, tmp_path))
    made = (tmp_path / f"{kind}_{seed}.csv").read_bytes()
    (run,) = fresh_runs.runs(kind, tmp_path, count=1)
    assert (run.facts["role"], run.facts["kind"], len(run)) == (role, kind, 5)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [made]


def test_calibration_and_test_share_no_seed():
    spans = [range(first, first + fresh_runs.COUNTS[kind]) for kind, first in fresh_runs.FIRST_SEEDS.items()]
    seeds = [seed for span in spans for seed in span]
    assert len(set(seeds)) == len(seeds) and min(seeds) > 26  # 1 to 26 made the training and the test runs


# calibration


def test_errors_of_a_run_are_those_of_every_start_at_every_horizon():
    found = errors_of_run(warming_run(drift_k=0.02), {"arx": RampPredictor()})
    assert {key: rows.shape for key, rows in found.items() if key[0] == "arx"} == {
        ("arx", minutes): (MINUTES - 60, 2) for minutes in (1, 5, 15, 30, 60)
    }
    residuals, measured = found["arx", 60].T
    assert residuals == pytest.approx(60 * 0.02, abs=0.1)  # the estimate lags behind by less than 0.1 K
    assert measured.tolist() == pytest.approx([20.0 + 0.02 * k for k in range(60, MINUTES)])


def test_the_half_width_is_the_quantile_over_the_runs():
    # ten runs whose errors after 5 min are about 0.1, 0.2, .., 1 K: the tenth is the ceil(11 * 0.9)-th
    runs = [warming_run(drift_k=0.02 * k) for k in range(1, 11)]
    predictors = {"arx": RampPredictor(), "pbm": RampPredictor(version="p")}
    errors = errors_of(runs, lambda: predictors, workers=0)
    intervals = coverage.calibrate(runs, lambda: predictors, workers=0)
    worst = np.abs(errors["arx", 5][-1][:, 0])
    assert worst.min() - 1e-4 <= intervals.half_width("arx", "1", 5) <= worst.max() + 1e-4
    assert intervals.half_width("pbm", "p", 60) is not None
    assert {row.regime for row in intervals.rows} == {"interpolation"}


@pytest.mark.parametrize("role", ["test", "train", "validate"])
def test_a_run_of_another_role_calibrates_nothing(role):
    runs = [*(warming_run() for _ in range(9)), warming_run(role=role)]
    with pytest.raises(DataError, match=f"'{role}' is not 'calibrate'"):
        coverage.calibrate(runs, lambda: {"arx": RampPredictor()}, workers=0)


# coverage


def errors(*residuals, measured=25.0):
    return {("arx", 5): [np.column_stack([residuals, np.full(len(residuals), measured)])]}


INTERVALS = Intervals((Interval("arx", "1", 5, 1.0, 100, "interpolation"),))


def test_coverage_is_the_share_inside_in_both_regimes():
    inside, hotter = errors(0.5, -1.0, 1.001, -2.0), errors(0.5, -2.0, 3.0, 3.0, measured=40.0)
    hotter["arx", 5].append(errors(0.1, measured=36.9)["arx", 5][0])
    (row,) = coverage.measure(INTERVALS, inside, hotter)
    assert (row.interpolation, row.extrapolation, row.extrapolation_hot) == (0.5, 0.4, 0.25)
    assert row.mae_k == pytest.approx((0.5 + 1.0 + 1.001 + 2.0) / 4)


def test_without_a_hotter_measurement_there_is_no_share_of_them():
    (row,) = coverage.measure(INTERVALS, errors(0.5), errors(0.5))
    assert math.isnan(row.extrapolation_hot)


def test_a_width_that_follows_holds_what_a_fixed_one_does_not():
    many = errors(*np.random.default_rng(5).normal(0.0, 3.0, 10000))
    (row,) = coverage.measure(INTERVALS, many, many)
    assert row.interpolation < 0.3  # two thirds of a normal are inside 1 sd, a quarter inside a third of it
    assert abs(row.interpolation_adaptive - 0.9) < 0.01  # log(4.9) / (RATE 10000) = 0.008


def test_the_table_marks_what_is_not_within_88_and_92_percent():
    (row,) = coverage.measure(INTERVALS, errors(0.5), errors(0.5))
    assert "! 100.0%" in coverage.table([row], {"arx": RampPredictor()})
    assert "! 92.0%" not in coverage.table([replace(row, interpolation=0.92)], {"arx": RampPredictor()})


def test_the_kept_figures_are_those_of_the_kept_table():
    kept = json.loads((coverage.RESULTS / "coverage.json").read_text())
    rows = [coverage.CoverageRow(**row) for row in kept["rows"]]
    predictors = {name: RampPredictor(version=version) for name, version in kept["versions"].items()}
    assert coverage.table(rows, predictors) == (coverage.RESULTS / "coverage.txt").read_text()
    seen = [row.interpolation for row in rows]
    assert 0.88 <= sum(seen) / len(seen) <= 0.92
    # 20 rows of 100 runs each: the table marks the one or two that chance puts just outside.
    assert all(0.87 <= share <= 0.93 for share in seen)
    assert sum(not 0.88 <= share <= 0.92 for share in seen) <= 2
