"""The recorded runs by role: who is trained on what, cut where, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.formats.run_file import RecordedRun, absence_facts, read_run, write_run
from training.data import datasets


def run_of(rows: int = 20, **facts: str) -> RecordedRun:
    columns = {
        "time_s": 60.0 * np.arange(rows),
        "temp_air_c": 22.0 + np.arange(rows) / 10.0,
        "heater_duty": np.arange(rows) % 2 / 2.0,
    }
    return RecordedRun(columns, {"role": "train", **facts}, Path("run.csv"))


def changed(run: RecordedRun, column: str, row: int, value: float) -> RecordedRun:
    values = run.columns[column].copy()
    values[row] = value
    return replace(run, columns={**run.columns, column: values})


def test_interpolation_has_all_runs_and_extrapolation_those_that_stay_low():
    every = datasets.training_runs("interpolation")
    low = datasets.training_runs("extrapolation")
    assert [run.path.stem for run in every] == [f"run_{number:02}" for number in range(1, 16)]
    assert len(low) >= 6
    assert max(run.columns["temp_air_c"].max() for run in low) <= 29.7
    names = [run.path for run in low]
    assert all(run.columns["temp_air_c"].max() > 29.7 for run in every if run.path not in names)


def test_each_file_says_what_it_is_for():
    for run in datasets.training_runs("interpolation"):
        assert run.facts["role"] == "train"
        assert run.facts["regime"] == ", ".join(datasets.regimes_of(run))
    for scenario in range(1, 7):
        facts = datasets.test_run(scenario).facts
        regime = "interpolation" if scenario <= 3 else "extrapolation"
        assert (facts["role"], facts["scenario"], facts["regime"]) == ("test", str(scenario), regime)


@pytest.mark.parametrize(
    ("row", "value", "low"),
    [(0, 29.7, True), (9, 29.700001, False), (19, np.nan, False), (19, np.inf, False)],
)
def test_one_row_above_the_limit_or_unknown_makes_a_run_hot(row, value, low):
    run = changed(run_of(), "temp_air_c", row, value)
    assert ("extrapolation" in datasets.regimes_of(run)) is low
    assert "interpolation" in datasets.regimes_of(run)


@pytest.mark.parametrize("regime", ["", "both", "Interpolation", None])
def test_another_regime_is_refused(regime):
    with pytest.raises(DataError, match="regime"):
        datasets.training_runs(regime)


@pytest.mark.parametrize("scenario", [0, 7, -1, 1.5, None])
def test_another_scenario_is_refused(scenario):
    with pytest.raises(DataError, match="scenario"):
        datasets.test_run(scenario)


def test_a_test_run_among_the_training_runs_and_a_training_run_as_scenario_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(datasets, "RUNS", tmp_path)
    with pytest.raises(DataError, match="no run files"):
        datasets.training_runs("interpolation")
    write_run(absence_facts(run_of(role="test")), tmp_path / "run_01.csv")
    write_run(absence_facts(run_of()), tmp_path / "scenario_1.csv")
    with pytest.raises(DataError, match=r"run_01\.csv: role"):
        datasets.training_runs("interpolation")
    with pytest.raises(DataError, match=r"scenario_1\.csv: role"):
        datasets.test_run(1)


def test_no_scenario_is_split_for_a_fit():
    for scenario in range(1, 7):
        with pytest.raises(DataError, match=rf"scenario_{scenario}\.csv: role: a test run"):
            datasets.split(datasets.test_run(scenario))


def test_every_training_run_is_cut_eighty_to_twenty_in_time():
    for run in datasets.training_runs("interpolation"):
        parts = datasets.split(run)
        (train,), (validate,) = parts.train, parts.validate
        assert len(train) + len(validate) == len(run)
        assert len(train) / len(run) == pytest.approx(0.8, abs=0.005)  # a row of 199 to 227
        joined = np.concatenate([train.columns["temp_air_c"], validate.columns["temp_air_c"]])
        np.testing.assert_array_equal(joined, run.columns["temp_air_c"])


def test_a_part_is_a_run_of_its_own():
    run = run_of(10, validate_from_s="480", start_utc="2026-07-01T12:00:00Z")
    (train,), (validate,) = datasets.split(run).train, datasets.split(run).validate
    assert [part.columns["time_s"].tolist() for part in (train, validate)] == [
        [60.0 * k for k in range(8)],
        [0.0, 60.0],
    ]
    assert validate.start_utc - run.start_utc == 480.0
    assert (train.facts["role"], validate.facts["role"]) == ("train", "validate")
    assert "validate_from_s" not in train.facts  # all of it is for training now
    assert train.path == validate.path == run.path


@pytest.mark.parametrize(
    ("validate_from_s", "rows"), [("1200", 0), ("1080", 18), ("1081", 0), ("120", 2), ("119", 2), ("60", 0)]
)
def test_a_cut_leaves_two_rows_on_both_sides_or_is_refused(validate_from_s, rows):
    run = run_of(20, validate_from_s=validate_from_s)
    if rows:
        assert len(datasets.split(run).train[0]) == rows
    else:
        with pytest.raises(DataError, match=r"run\.csv: validate_from_s: a part of less than two rows"):
            datasets.split(run)


@pytest.mark.parametrize("text", ["noon", "", "nan", "-inf", "inf"])
def test_a_cut_at_no_time_is_refused(text):
    with pytest.raises(DataError, match=r"run\.csv: validate_from_s"):
        datasets.split(run_of(20, validate_from_s=text))


def test_a_run_that_says_nothing_is_cut_at_eighty_per_cent_and_one_that_validates_is_not_cut():
    assert [len(part) for part in datasets.split(run_of(20)).train] == [16]
    whole = run_of(20, role="validate")
    assert datasets.split(whole) == datasets.Split([], [whole])


def test_the_hash_is_of_the_numbers_wherever_they_lie(tmp_path):
    run = changed(run_of(), "temp_air_c", 3, np.nan)
    write_run(absence_facts(run), tmp_path / "elsewhere.csv")
    again = replace(read_run(tmp_path / "elsewhere.csv"), facts={"notes": "another fact"})
    assert datasets.data_sha256([run]) == datasets.data_sha256([again])
    assert len(datasets.data_sha256([run])) == 64


@pytest.mark.parametrize(
    "other",
    [
        [],
        [run_of(), run_of()],
        [run_of(19)],
        [changed(run_of(), "temp_air_c", 7, 22.70000001)],
        [changed(run_of(), "temp_air_c", 7, np.nan)],
        [replace(run_of(), columns={**run_of().columns, "fan_on": np.zeros(20)})],
    ],
)
def test_other_numbers_have_another_hash(other):
    assert datasets.data_sha256(other) != datasets.data_sha256([run_of()])
