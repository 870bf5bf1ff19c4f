"""The tuning of the networks: the same trials for each, chosen on validation parts, as committed."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from training_runs import box_run

from edge.core.errors import DataError
from edge.core.predictor import Predictor
from edge.formats.run_file import RecordedRun, data_sha256
from training import __main__
from training.data.datasets import training_runs
from training.data.pairs import split_all
from training.evaluate import tune_networks
from training.models.networks import NETWORKS
from training.models.study import SCENARIOS
from training.models.tuned_settings import (
    BATCH_SIZES,
    DROPOUTS,
    FILE,
    LEARNING_RATES,
    WIDTHS,
    NetworkTrial,
    best_trial,
    read_trials,
    trial_settings,
)
from training.models.window_network import WindowSettings

RESULTS = Path(tune_networks.__file__).parents[1] / "results" / "networks"
HASH = "a" * 64


def trial(network: str, number: int, mae_k: float | None) -> NetworkTrial:
    settings = trial_settings(3, 0)[number]
    return NetworkTrial(network, "interpolation", number, settings, 100, HASH, "", mae_k, 5, 1.0)


def test_the_trials_begin_with_the_papers_and_try_both_targets() -> None:
    drawn = trial_settings(9, 0)
    assert drawn == trial_settings(9, 0) != trial_settings(9, 1)
    assert drawn[0] == WindowSettings()
    assert sum(one.predicts_increment for one in drawn[1:]) == 4
    for one in drawn[1:]:
        assert LEARNING_RATES[0] <= one.learning_rate <= LEARNING_RATES[1]
        assert one.batch_size in BATCH_SIZES and one.hidden in WIDTHS and one.dropout in DROPOUTS
    # Stopping is not tuned: who may train longer would have the larger budget.
    assert {(one.epochs, one.min_delta, one.tolerance) for one in drawn} == {(5000, 5e-4, 10)}


def test_the_trial_with_the_least_validation_error_is_best() -> None:
    found = [trial("gru", 0, 0.3), trial("gru", 1, 0.2), trial("gru", 2, None)]
    assert best_trial(found, "gru", "interpolation", HASH).trial == 1


@pytest.mark.parametrize(
    ("found", "sha256", "message"),
    [
        ([trial("gru", 0, 0.3)], "b" * 64, "gru: no trial on interpolation as it is now"),
        ([trial("tcn", 0, 0.3)], HASH, "--networks gru --data interpolation"),
        ([trial("gru", 0, 0.3), trial("gru", 1, 0.1), trial("tcn", 0, 0.3)], HASH, "are not those of tcn"),
        ([trial("gru", 0, None)], HASH, "gru: no trial on interpolation gave a finite forecast"),
    ],
    ids=["other data", "other network", "a larger budget", "nothing finite"],
)
def test_a_choice_without_equal_trials_is_refused(
    found: list[NetworkTrial], sha256: str, message: str
) -> None:
    with pytest.raises(DataError, match=message):
        best_trial(found, "gru", "interpolation", sha256)


@pytest.mark.parametrize("content", ["{", "[1]", '[{"network": "gru"}]', '{"network": "gru"}'])
def test_a_damaged_file_of_trials_is_named(content: str, tmp_path: Path) -> None:
    (tmp_path / FILE).write_text(content)
    with pytest.raises(DataError, match=FILE):
        read_trials(tmp_path)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> list[Sequence[RecordedRun]]:
    """Short trainings on two short runs; returns the runs that trials are judged on."""
    judged: list[Sequence[RecordedRun]] = []
    measure: Callable[..., float] = tune_networks.mean_free_run_mae

    def note(predictor: Predictor, runs: Sequence[RecordedRun]) -> float:
        judged.append(runs)
        return measure(predictor, runs)

    parts = split_all([box_run(1, rows=200), box_run(2, rows=200)])
    tiny = replace(WindowSettings(), epochs=1, hidden=4)
    monkeypatch.setattr(tune_networks, "tuning_data", lambda data, box: (parts, HASH))
    monkeypatch.setattr(tune_networks, "trial_settings", lambda count, seed: [tiny] * count)
    monkeypatch.setattr(tune_networks, "mean_free_run_mae", note)
    return judged


def test_trials_are_judged_on_validation_parts_and_others_stay(
    small: list[Sequence[RecordedRun]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["tune-networks", "--data", "extrapolation", "--trials", "2", "--results", str(tmp_path)]
    assert __main__.main([*words, "--networks", "tcn", "gru"]) == 0
    first = read_trials(tmp_path)
    assert [(one.network, one.trial) for one in first] == [("gru", 0), ("gru", 1), ("tcn", 0), ("tcn", 1)]
    assert {run.facts["role"] for runs in small for run in runs} == {"validate"}
    assert "extrapolation: mean free-run MAE" in capsys.readouterr().out
    assert __main__.main([*words, "--networks", "tcn"]) == 0
    again = read_trials(tmp_path)
    assert again[:2] == first[:2]  # the GRU's, seconds and all
    assert [one.validation_mae_k for one in again] == [one.validation_mae_k for one in first]


@pytest.mark.parametrize(
    ("words", "message"),
    [(["--networks", "rnn"], "--networks: rnn: known are"), (["--trials", "0"], "--trials: 0: at least one")],
)
def test_what_cannot_be_tuned_is_refused(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert __main__.main(["tune-networks", "--results", str(tmp_path), *words]) == 2
    assert message in capsys.readouterr().err


def test_the_committed_trials_are_equal_and_on_the_recorded_runs() -> None:
    found = read_trials(RESULTS)
    drawn = trial_settings(12, tune_networks.DRAWN_BY)
    for data in tune_networks.DATA:
        counts = set()
        for network in NETWORKS:
            mine = [one for one in found if (one.network, one.data) == (network, data)]
            assert [one.settings for one in mine] == drawn[: len(mine)]
            assert {one.seed for one in mine} == {tune_networks.TRAINED_BY}
            counts.add(len(mine))
        assert len(counts) == 1
    for regime in SCENARIOS:
        hashes = {one.data_sha256 for one in found if one.data == regime}
        assert hashes == {data_sha256(training_runs(regime))}
