"""Free runs, records of trainings, files of weights, and the command that makes them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from training_runs import BOX, box_run

from edge.core.errors import DataError
from edge.core.predictor import Columns, Floats
from edge.formats.run_file import RecordedRun, inside_names
from edge.models.pbm import Pbm, read_twin
from edge.twin.model import BoxTwin
from training import __main__
from training.models import ham, study
from training.models.predictors import GuardedHamPredictor, HamPredictor, WindowPredictor
from training.models.registry import ARX_FILE, MODELS, NETWORK_FILE, TWIN_FILE
from training.models.rollout import START_ROWS, errors, free_run, one_step
from training.models.study import TrainedModel, TrainingJob
from training.models.summary import best_seed, records, table
from training.models.weights import NETWORKS, load_network, save_network
from training.models.window_network import LstmNet, WindowSettings
from training.models.window_network import train as train_window


class Recorder:
    """A predictor that holds the last temperature and keeps what it was given."""

    name, version, step_s, rows_needed = "held", "", 60.0, 1

    def __init__(self) -> None:
        self.given: list[tuple[Columns, Floats, Columns]] = []

    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        self.given.append((history, controls, ahead))
        return np.full(controls.shape[:2], history["temp_air"][-1])


def test_a_free_run_sees_ten_temperatures_and_all_inputs() -> None:
    run, predictor = box_run(1), Recorder()
    assert len(free_run(predictor, run)) == len(run) - START_ROWS
    [(history, controls, ahead)] = predictor.given
    assert history["temp_air"].tolist() == run.columns["temp_air_c"][:10].tolist()
    # The row of now acts on the next: its inputs are the first of those to come.
    assert controls[0, :, 0].tolist() == run.columns["heater_duty"][9:-1].tolist()
    assert len(ahead["temp_ambient"]) == len(run) - START_ROWS


def test_single_steps_begin_anew_from_each_measurement() -> None:
    run = box_run(1)
    assert one_step(Recorder(), run).tolist() == run.columns["temp_air_c"][9:-1].tolist()


def test_the_physics_that_made_a_run_reproduces_it() -> None:
    # A box whose only state is the air: nothing is hidden at the start.
    box = BoxTwin(effects={"wall_loss": {"UA": 4.0}, "extra_capacity": {"kC": 20.0}})
    run = box_run(1, box=box)
    assert errors(free_run(Pbm(box), run), run).worst_k < 1e-9


def test_errors_are_of_what_was_measured() -> None:
    run = box_run(1)
    predicted = run.columns["temp_air_c"][START_ROWS:] + np.where(np.arange(80) % 2, 1.0, -3.0)
    run.columns["temp_air_c"][20] = (
        np.nan
    )  # of the rows that are 3 K too low: 39 of them are left, and 40 others
    found = errors(predicted, run)
    assert found.rows == 79
    assert found.mae_k == pytest.approx((39 * 3.0 + 40 * 1.0) / 79)
    assert found.bias_k == pytest.approx((-39 * 3.0 + 40 * 1.0) / 79)
    assert found.worst_k == pytest.approx(3.0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_forecast_that_is_no_number_is_an_error_and_no_score(value: float) -> None:
    predicted = np.full(80, 25.0)
    predicted[7] = value
    with pytest.raises(DataError, match="not finite from step 7 on"):
        errors(predicted, box_run(1))


@pytest.mark.parametrize("rows", [9, 10])
def test_a_run_with_nothing_after_the_start_is_refused(rows: int) -> None:
    with pytest.raises(DataError, match="more than 10"):
        free_run(Recorder(), box_run(1, rows=rows))


def test_the_shortest_run_has_one_step() -> None:
    assert len(free_run(Recorder(), box_run(1, rows=11))) == 1


def networks() -> dict[str, Any]:
    runs, tiny = [box_run(1)], WindowSettings(epochs=1, hidden=4)
    return {
        **{name: train_window(NETWORKS[name], runs, 0, tiny)[0] for name in NETWORKS},
        "lstm_increment": train_window(LstmNet, runs, 0, replace(tiny, predicts_increment=True))[0],
        "ham": ham.train(runs, 0, ham.HamSettings(epochs=1, hidden=4))[0],
        "ham_guarded": ham.train_guarded(runs, BOX, 0, ham.GuardedHamSettings(epochs=1))[0],
    }


PREDICTORS = dict.fromkeys((*NETWORKS, "lstm_increment"), WindowPredictor) | {
    "ham": HamPredictor, "ham_guarded": GuardedHamPredictor}  # fmt: skip


@pytest.fixture(scope="module")
def trained() -> Mapping[str, Any]:
    return networks()


@pytest.mark.parametrize("name", PREDICTORS)
def test_saved_weights_give_the_same_forecast(name: str, trained: Mapping[str, Any], tmp_path: Path) -> None:
    save_network(trained[name], tmp_path / NETWORK_FILE, {"seed": 3})
    loaded, facts = load_network(tmp_path / NETWORK_FILE)
    assert facts == {"seed": 3}
    run = box_run(2)
    before, after = (free_run(PREDICTORS[name](network), run) for network in (trained[name], loaded))
    assert after.tolist() == before.tolist()


@pytest.mark.parametrize("content", [b"", b"not weights", None])
def test_a_file_that_holds_no_network_is_refused(content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / NETWORK_FILE
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(DataError, match=NETWORK_FILE):
        load_network(path)


def test_weights_of_another_format_are_refused(tmp_path: Path) -> None:
    torch.save({"format": 0, "kind": "LstmNet"}, tmp_path / NETWORK_FILE)
    with pytest.raises(DataError, match="format"):
        load_network(tmp_path / NETWORK_FILE)


@pytest.mark.parametrize("name", PREDICTORS)
def test_sequences_of_a_batch_do_not_mix(name: str, trained: Mapping[str, Any]) -> None:
    predictor, columns = PREDICTORS[name](trained[name]), inside_names(box_run(1))
    history = {key: values[:10] for key, values in columns.items()}
    ahead = {key: values[9:14] for key, values in columns.items()}
    controls = np.random.default_rng(0).random((6, 5, 2)).round()
    together = predictor.rollout(history, controls, ahead)
    alone = [predictor.rollout(history, one[None], ahead)[0] for one in controls]
    assert together == pytest.approx(np.array(alone), abs=1e-4)


@pytest.fixture
def small_data(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "training_runs", lambda regime: [box_run(1), box_run(2), box_run(3)])
    monkeypatch.setattr(study, "test_run", lambda scenario: box_run(10 + scenario, role="test"))
    monkeypatch.setattr(study, "data_sha256", lambda runs: f"{len(runs)} runs")


def held(runs: Sequence[RecordedRun], seed: int, log: Path | None) -> TrainedModel:
    return TrainedModel(Recorder(), {}, {"validation_loss": 1.0 - 0.1 * seed}, lambda out, facts: None)


def three_trainings(out: Path) -> None:
    for seed in range(3):
        study.study(TrainingJob("lstm", "interpolation", seed, ""), held, out, None)


@pytest.mark.usefixtures("small_data")
def test_a_record_says_what_was_trained_on_what_and_how_well(tmp_path: Path) -> None:
    job = TrainingJob("ham", "interpolation", 7, "greenhouse-train ham")
    study.study(job, quick_ham, tmp_path, None)
    record = json.loads((tmp_path / "ham" / "interpolation" / "seed_7" / "result.json").read_text())
    assert record["command"] == "greenhouse-train ham"
    assert (record["model"], record["regime"], record["seed"]) == ("ham", "interpolation", 7)
    assert record["data_sha256"] == "3 runs"
    assert record["settings"]["batch_size"] == 64
    temps = np.concatenate(
        [box_run(seed).columns["temp_air_c"][:72] for seed in (1, 2, 3)]
    )  # the training parts
    assert record["validity"]["temp_air_c"] == [temps.min(), temps.max()]
    assert record["versions"]["torch"].startswith("2.")
    assert record["wall_s"] > 0.0
    assert 10.0 < record["peak_rss_mib"] < 100_000.0
    assert list(record["scenarios"]) == ["1", "2", "3"]
    assert record["scenarios"]["1"]["free_run"]["rows"] == 80


def quick_ham(runs: Sequence[RecordedRun], seed: int, log: Path | None) -> TrainedModel:
    network, _ = ham.train(runs, seed, ham.HamSettings(epochs=1, hidden=4), log)
    settings = {"batch_size": ham.HamSettings().batch_size}
    return TrainedModel(HamPredictor(network), settings, {}, lambda out, facts: None)


@pytest.mark.usefixtures("small_data")
def test_the_same_seed_gives_the_same_metrics(tmp_path: Path) -> None:
    jobs = [TrainingJob("ham", "interpolation", seed, "") for seed in (7, 7, 8)]
    first, again, other = (study.study(job, quick_ham, tmp_path, None)["scenarios"] for job in jobs)
    assert first == again != other


@pytest.mark.usefixtures("small_data")
@pytest.mark.parametrize("name", ["linear", "linear_ambient", "pbm", "twin"])
def test_models_without_a_seed_are_trained_and_kept(name: str, tmp_path: Path) -> None:
    job = TrainingJob(name, "extrapolation", 0, "")
    record = study.study(job, MODELS[name], tmp_path, None)
    assert np.isfinite(record["scenarios"]["4"]["free_run"]["mae_k"])
    model = {"linear": ARX_FILE, "linear_ambient": ARX_FILE, "pbm": TWIN_FILE, "twin": TWIN_FILE}[name]
    assert {path.name for path in job.folder(tmp_path).iterdir()} == {study.RESULT_FILE, model}


@pytest.mark.usefixtures("small_data")
def test_the_fitted_twin_finds_the_box_and_is_kept_as_a_file(tmp_path: Path) -> None:
    job = TrainingJob("twin", "interpolation", 0, "")
    record = study.study(job, MODELS["twin"], tmp_path, None)
    assert record["scenarios"]["1"]["free_run"]["mae_k"] < 0.01
    effects = read_twin(job.folder(tmp_path) / TWIN_FILE).twin.effects
    assert effects["heater_lag"]["tau_h"] == pytest.approx(BOX.effects["heater_lag"]["tau_h"], rel=0.01)


@pytest.mark.usefixtures("small_data")
def test_the_table_gives_mean_and_spread_over_the_seeds(tmp_path: Path) -> None:
    three_trainings(tmp_path)
    found = records(tmp_path)
    for seed, record in enumerate(found):
        for scenario in record["scenarios"].values():
            scenario["free_run"]["mae_k"] = 1.0 + seed
    made = table(found, ["lstm"])
    assert made.heads[1:] == ("1", "2", "3", "mean", "4", "5", "6", "mean")
    [row] = made.rows
    assert row[0] == "lstm" and row.count("2.000 ± 1.000") == 4  # of 1, 2 and 3 K


@pytest.mark.usefixtures("small_data")
def test_the_seed_to_deploy_is_chosen_by_validation(tmp_path: Path) -> None:
    three_trainings(tmp_path)
    assert best_seed(records(tmp_path), "lstm", "interpolation") == 2
    with pytest.raises(DataError, match="no training of lstm for extrapolation"):
        best_seed(records(tmp_path), "lstm", "extrapolation")


@pytest.mark.usefixtures("small_data")
def test_the_command_trains_a_family_and_prints_its_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["pbm", "--out", str(tmp_path / "out"), "--logs", str(tmp_path / "logs")]
    assert __main__.main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    models = ["pbm", "pbm_fitted", "twin"]
    rows = [model for model in models for _ in range(2)] + ["free-run", *models]
    assert [line.split()[0] for line in lines if line] == rows
    assert len(list((tmp_path / "out").rglob("result.json"))) == 6


def test_an_error_of_the_data_ends_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(study, "training_runs", lambda regime: [box_run(1, role="test")])
    assert __main__.main(["linear", "--out", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("greenhouse-train linear: ")
    assert "TrainingJob(name='linear'" in line
    assert "box_1.csv: role" in line


def test_losses_are_logged_for_tensorboard(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    ham.train([box_run(1)], 0, ham.HamSettings(epochs=3, hidden=4), tmp_path)
    events = EventAccumulator(str(tmp_path)).Reload()
    assert [event.step for event in events.Scalars("loss/validate")] == [1, 2, 3]
