"""The bundle that ships with the software: whole, signed, and what it says it is."""

import json
from pathlib import Path

import numpy as np
import pytest

from edge.bundle.predictors import loader
from edge.bundle.store import PACKAGED_FOLDER, BundleStore
from edge.models.arx_file import DEFAULT_PATH
from training.data import datasets
from training.data.datasets import data_sha256, training_runs
from training.models.rollout import errors, free_run
from training.rl.saved_policy import FOLDERS, best_folder, read_record

NO_KEYS = Path("/nonexistent")  # only the packaged key is trusted
POLICIES = Path(__file__).parents[3] / "training" / "results" / "policies"


@pytest.fixture(scope="module")
def packaged():
    return BundleStore(NO_KEYS, NO_KEYS, loader(60.0)).load("packaged")


def test_it_is_signed_and_holds_all_four_models(packaged):
    assert list(packaged.predictors) == ["arx", "pbm", "lstm", "ham"]
    assert packaged.manifest.data_sha256 == data_sha256(training_runs("interpolation"))


def test_it_has_a_policy_for_each_of_the_papers_controllers(packaged):
    assert list(packaged.policies) == ["RL-Off", "RL-Off-P", "RL-On-P", "RL-Tr-P"]
    for name, policy in packaged.policies.items():
        assert policy.contract.facts["variant"] == name


def test_its_policies_are_the_best_that_are_kept(packaged):
    for name, place in FOLDERS.items():
        best = read_record(best_folder(sorted((POLICIES / place).glob("seed_*"))))
        assert packaged.policies[name].version == best["policy"]


def test_its_arx_is_the_packaged_one():
    assert (PACKAGED_FOLDER / "arx.json").read_bytes() == DEFAULT_PATH.read_bytes()


def test_its_forecasts_have_intervals(packaged):
    rows = json.loads((PACKAGED_FOLDER / "intervals.json").read_text())["intervals"]
    versions = {(row["predictor"], row["version"]) for row in rows}
    assert versions == {(name, model.version) for name, model in packaged.predictors.items()}
    assert {row["horizon_min"] for row in rows} == {1, 5, 15, 30, 60}


@pytest.mark.parametrize("scenario", ["1", "2", "3"])
def test_its_networks_forecast_the_test_runs_as_its_report_says(packaged, scenario):
    report = json.loads((PACKAGED_FOLDER / "report.json").read_text())
    run = datasets.test_run(int(scenario))
    for name, trained in (("lstm", "lstm"), ("ham", "ham_guarded")):
        mae_k = errors(free_run(packaged.predictors[name], run), run).mae_k
        assert mae_k == pytest.approx(report["errors"][trained][scenario], abs=1e-3)


def test_every_model_gives_persistence_a_lesson(packaged):
    run = datasets.test_run(2)
    still = np.abs(run.columns["temp_air_c"] - run.columns["temp_air_c"][9]).mean()
    for model in packaged.predictors.values():
        assert errors(free_run(model, run), run).mae_k < 0.5 * still
