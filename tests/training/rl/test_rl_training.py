"""Training of policies: reproducible, exported as trained, kept with its record."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from edge.core.errors import DataError
from edge.models.onnx_policy import read_policy
from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import FEATURES
from training.data.datasets import training_runs
from training.rl.algorithms.registry import ALGORITHMS, DQN
from training.rl.episodes import recorded_observations
from training.rl.parity import main as tell_parity
from training.rl.parity import parity
from training.rl.saved_policy import POLICY_FILE, WEIGHTS_FILE, best_folder, load_q_network, save_q_network
from training.rl.settings import DqnSettings
from training.rl.study import PolicyJob, export, graph_of, greedy, play, study, world_of

POLICIES = Path(__file__).parents[3] / "training" / "results" / "policies"
SMALL = DqnSettings(steps=480, hidden=(16,), batch=16, learning_starts=64, target_every=64)
FACTS = {
    "variant": "RL-Off", "sample_s": 60.0, "model": "ham", "model_sha256": "", "data_sha256": "",
    "command": "", "seed": 0, "settings": {}, "metrics": {},
}  # fmt: skip


@pytest.fixture(scope="module")
def runs():
    return training_runs("interpolation")


@pytest.fixture(scope="module")
def observations(runs):
    return recorded_observations(runs)


def test_the_same_seed_gives_the_same_policy_and_another_another(runs):
    world = world_of("RL-Off", "pbm", runs)
    weights = [ALGORITHMS[DQN].learn(world, seed, SMALL)[0].weight.detach().numpy() for seed in (1, 1, 2)]
    assert np.array_equal(weights[0], weights[1])
    assert not np.array_equal(weights[0], weights[2])


def test_a_training_learns(runs):
    """In 8000 steps, to hold the box better than any one action does."""
    world = world_of("RL-Off", "pbm", runs)
    network = ALGORITHMS[DQN].learn(world, 1, replace(SMALL, steps=8000, hidden=(64,), batch=128, updates=2))
    learnt = play(greedy(network), world, count=16).reward
    fixed = [
        play(lambda seen, action=action: np.full(len(seen), action), world, count=16).reward
        for action in range(2, 14, 2)
    ]
    assert learnt > max(fixed)


def test_a_training_is_kept_with_its_record(tmp_path, runs):
    record = study(PolicyJob("RL-Off-P", "pbm", 4, "greenhouse-train rl", settings=SMALL), tmp_path / "a")
    kept = json.loads((tmp_path / "a" / "record.json").read_text())
    assert kept == json.loads(json.dumps(record))
    assert (kept["variant"], kept["seed"], kept["settings"]["steps"]) == ("RL-Off-P", 4, 480)
    policy = read_policy(tmp_path / "a" / POLICY_FILE, "RL-Off-P", 60.0)
    assert policy.version == kept["policy"]
    assert policy.contract.facts["model_sha256"] == kept["model_sha256"]
    assert kept["metrics"]["validation"]["mae_k"] > 0.0


def test_the_best_is_chosen_by_its_validation(tmp_path):
    for seed, reward in enumerate((-2.0, -1.0, -3.0)):
        folder = tmp_path / f"seed_{seed}"
        folder.mkdir()
        record = {"metrics": {"validation": {"reward": reward}}}
        (folder / "record.json").write_text(json.dumps(record))
    assert best_folder(sorted(tmp_path.iterdir())).name == "seed_1"
    with pytest.raises(DataError, match="no training"):
        best_folder([])


def test_there_are_ten_thousand_recorded_observations(observations):
    assert len(observations) >= 10_000
    assert observations.shape[1] == len(FEATURES)
    assert np.isfinite(observations).all()


def test_a_graph_chooses_as_its_network_on_every_recorded_observation(tmp_path, observations):
    torch.manual_seed(3)
    network = nn.Sequential(nn.Linear(len(FEATURES), 32), nn.ReLU(), nn.Linear(32, ACTIONS))
    policy = export(network, "RL-Off", observations, FACTS, tmp_path / "p.onnx")
    found = parity(network, policy, observations)
    assert (found.different, found.observations) == (0, len(observations))


def test_parity_finds_a_policy_that_differs(tmp_path, observations):
    torch.manual_seed(3)
    network = nn.Sequential(nn.Linear(len(FEATURES), ACTIONS))
    policy = export(network, "RL-Off", observations, FACTS, tmp_path / "p.onnx")
    with torch.no_grad():
        network[0].bias[5] += 10.0
    assert parity(network, policy, observations).different > 0


def test_parity_without_folders_is_of_all_that_are_kept(tmp_path, observations, capsys):
    torch.manual_seed(3)
    network = nn.Sequential(nn.Linear(len(FEATURES), ACTIONS))
    kept = [tmp_path / "rl-off" / "ham" / f"seed_{seed}" for seed in range(2)]
    for folder in kept:
        folder.mkdir(parents=True)
        export(network, "RL-Off", observations, FACTS, folder / POLICY_FILE)
        save_q_network(network, folder / WEIGHTS_FILE)
    assert tell_parity([], tmp_path) == 0
    told = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in told] == [str(folder) for folder in kept]
    assert all(f"0 of {len(observations)} actions differ" in line for line in told)


def test_parity_where_no_policy_is_kept_is_not_taken_for_success(tmp_path, capsys):
    assert tell_parity([], tmp_path) == 2
    assert str(tmp_path) in capsys.readouterr().err


def test_layers_that_a_graph_does_not_hold_are_refused():
    with pytest.raises(DataError, match="Tanh"):
        graph_of(nn.Sequential(nn.Linear(2, 2), nn.Tanh()))


WITH_WEIGHTS = sorted(path.parent for path in POLICIES.glob(f"*/*/seed_*/{WEIGHTS_FILE}"))


def test_the_best_policy_of_each_kind_has_its_weights():
    for kind in {path.parent.parent for path in POLICIES.glob("*/*/seed_*/record.json")}:
        assert best_folder(sorted(kind.glob("seed_*"))) in WITH_WEIGHTS


@pytest.mark.parametrize("folder", WITH_WEIGHTS, ids=lambda p: "/".join(p.parts[-3:]))
def test_a_kept_policy_chooses_on_the_rig_as_it_was_trained(folder, observations):
    policy = read_policy(folder / POLICY_FILE, "kept", 60.0)
    found = parity(load_q_network(folder / WEIGHTS_FILE), policy, observations)
    assert (found.different, found.observations) == (0, len(observations))
