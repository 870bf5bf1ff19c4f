"""The recorded runs: by role, what they span, what is refused, and that they can be made again."""

import itertools
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.formats.profile_file import read_profile
from edge.formats.run_file import RecordedRun, absence_facts, period, read_run, write_run
from firmware_protocol.virtual_board.profiles.record import read
from training.data import datasets, record
from training.data.draw_profiles import PLANS, draw, path_of


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


RECORDINGS = {recording.name: recording for recording in record.recordings()}
TEST_RANGES_C = {1: (25.5, 30.3), 2: (25.4, 30.0), 3: (25.0, 33.3)}  # paper, tab:results-model-scenarios


def committed(name: str) -> RecordedRun:
    return read_run(datasets.RUNS / f"{name}.csv")


def profile_of(scenario: int) -> int:
    return (scenario - 1) % 3 + 1


def on_lengths(values: np.ndarray) -> list[int]:
    """How many rows each stretch of non-zero inputs has."""
    return [len(list(rows)) for on, rows in itertools.groupby(values > 0.0) if on]


def test_there_is_a_file_for_every_recording_and_no_other():
    assert sorted(path.stem for path in datasets.RUNS.iterdir()) == sorted(RECORDINGS)
    assert len(RECORDINGS) == 21


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_run_is_whole_and_says_how_it_was_made(name):
    run, recording = committed(name), RECORDINGS[name]
    profile = read_profile(recording.profile)
    assert period(run) == 60.0
    assert run.columns["time_s"][-1] == profile.end_s - profile.record_from_s
    assert run.facts["profile"] == recording.profile.name
    assert (run.facts["role"], run.facts["seed"]) == (recording.role, str(recording.seed))
    for column in ("temp_air_c", "temp_ambient_c", "heater_duty", "fan_on"):
        assert np.isfinite(run.columns[column]).all()


def test_no_two_runs_share_a_board():
    seeds = [recording.seed for recording in RECORDINGS.values()]
    assert len(set(seeds)) == len(seeds)


def test_training_spans_the_papers_range_in_fifteen_runs_of_about_212_minutes():
    runs = [committed(name) for name in RECORDINGS if name.startswith("run_")]
    assert np.mean([run.columns["time_s"][-1] for run in runs]) / 60.0 == pytest.approx(212.0, abs=1.0)
    shown = np.concatenate([run.columns["temp_air_c"] for run in runs])
    assert shown.min() == pytest.approx(21.8, abs=0.31)  # paper: 21.8 to 36.9
    assert shown.max() == pytest.approx(36.9, abs=0.3)


@pytest.mark.parametrize("scenario", datasets.SCENARIOS)
def test_each_test_run_spans_the_papers_range(scenario):
    run = datasets.test_run(scenario)
    low, high = TEST_RANGES_C[profile_of(scenario)]
    assert run.columns["temp_air_c"].min() == pytest.approx(low, abs=0.3)
    assert run.columns["temp_air_c"].max() == pytest.approx(high, abs=0.3)
    assert run.columns["time_s"][-1] == 212 * 60.0
    assert run.facts["notes"] == "safety changed no command"


@pytest.mark.parametrize("profile", [1, 2, 3])
def test_each_test_profile_has_the_character_that_the_paper_describes(profile):
    run = datasets.test_run(profile)
    heating, blowing = on_lengths(run.columns["heater_duty"]), on_lengths(run.columns["fan_on"])
    share = sum(heating) / len(run)
    if profile == 1:  # heater non-zero for a larger portion of the time, fan relatively frequent
        assert share > 0.8 and len(blowing) >= 12
    elif profile == 2:  # sparse heating of longer duration, fan less frequent
        assert share < 0.6 and np.mean(heating) >= 15 and 1 <= len(blowing) <= 3
    else:  # both intermittent
        assert share < 0.7 and len(heating) >= 10 and np.mean(heating) < 12 and len(blowing) >= 5


@pytest.mark.parametrize("profile", [1, 2, 3])
def test_the_generator_draws_the_committed_profile_again(profile):
    facts, rows = read(path_of(profile))
    candidate = draw(PLANS[profile - 1], int(facts["seed"]))
    assert candidate.rows == rows
    assert candidate.fits(PLANS[profile - 1])


@pytest.mark.parametrize(("name", "minutes"), [("run_02", 5), ("scenario_3", 44)])
def test_recorded_again_a_run_begins_with_the_same_rows(tmp_path, name, minutes):
    again = record.record(RECORDINGS[name], tmp_path / "again.csv", minutes)
    kept = committed(name)
    rows = len(again)
    assert rows >= 5
    for column, values in kept.columns.items():
        np.testing.assert_array_equal(again.columns[column][:rows], values[:rows])
    assert again.facts.keys() == kept.facts.keys()
    # The greeting's length is the protocol's, not the run's: it moves the first tick by milliseconds.
    begun, before = (datetime.fromisoformat(facts["start_utc"]) for facts in (again.facts, kept.facts))
    assert abs((begun - before).total_seconds()) < 0.1


def test_check_tells_what_differs_and_changes_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(record, "RUNS", tmp_path)
    monkeypatch.setattr(record, "record", lambda one, path: path.write_text(one.name))
    assert run_main(monkeypatch, "run_01", "scenario_6") == 0
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "run_01.csv": "run_01",
        "scenario_6.csv": "scenario_6",
    }
    (tmp_path / "run_01.csv").write_text("other")
    assert run_main(monkeypatch, "--check", "run_01", "scenario_6") == 1
    assert "1 of 2 runs differ: run_01" in capsys.readouterr().out
    assert (tmp_path / "run_01.csv").read_text() == "other"
    assert run_main(monkeypatch, "--check", "scenario_6") == 0


def test_an_unknown_run_is_refused(monkeypatch, capsys):
    with pytest.raises(SystemExit):
        run_main(monkeypatch, "run_16")
    assert "there is no run run_16" in capsys.readouterr().err


def test_an_experiment_that_fails_is_no_recording(tmp_path):
    gone = replace(RECORDINGS["run_01"], profile=Path("gone.csv"))
    with pytest.raises(record.GreenhouseError, match=r"again\.csv: greenhouse experiment failed"):
        record.record(gone, tmp_path / "again.csv")
    assert not (tmp_path / "again.csv").exists()


def run_main(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["record", *words])
    return record.main()
