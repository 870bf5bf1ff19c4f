"""The committed runs and profiles: what they span, and that they can be made again."""

import itertools
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from edge.formats.profile_file import read_profile
from edge.formats.run_file import RecordedRun, period, read_run
from firmware_protocol.virtual_board.profiles.record import read
from training.data import datasets, record
from training.data.draw_profiles import PLANS, draw, path_of

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
