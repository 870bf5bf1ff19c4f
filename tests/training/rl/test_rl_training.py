"""Training of policies: by each algorithm, reproducible, exported as trained, kept with its record."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from edge.core.errors import DataError
from edge.models.onnx_policy import read_policy
from edge.models.policy_actions import ACTIONS, LEVELS, command_of
from edge.models.policy_observation import FEATURES
from training.data.datasets import training_runs
from training.rl.algorithms import dagger, dqn
from training.rl.algorithms.algorithm import train
from training.rl.algorithms.registry import ALGORITHMS, DQN, algorithm_of
from training.rl.boxes import START_ROWS, BoxesNow, EpisodeBoxes, World
from training.rl.command import POLICIES, folder_of
from training.rl.episodes import DrawnEpisodes, recorded_observations
from training.rl.models import LstmModel
from training.rl.parity import main as tell_parity
from training.rl.parity import parity
from training.rl.read_model import read_model
from training.rl.reward import Weights
from training.rl.saved_policy import POLICY_FILE, WEIGHTS_FILE, best_folder, load_q_network, save_q_network
from training.rl.settings import DqnSettings
from training.rl.study import PolicyJob, export, graph_of, greedy, play, study, world_of

KEPT = Path(__file__).parents[3] / "training" / "results" / "policies"
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


WITH_WEIGHTS = sorted(path.parent for path in KEPT.glob(f"*/*/seed_*/{WEIGHTS_FILE}"))


def test_the_best_policy_of_each_kind_has_its_weights():
    for kind in {path.parent.parent for path in KEPT.glob("*/*/seed_*/record.json")}:
        assert best_folder(sorted(kind.glob("seed_*"))) in WITH_WEIGHTS


@pytest.mark.parametrize("folder", WITH_WEIGHTS, ids=lambda p: "/".join(p.parts[-3:]))
def test_a_kept_policy_chooses_on_the_rig_as_it_was_trained(folder, observations):
    policy = read_policy(folder / POLICY_FILE, "kept", 60.0)
    found = parity(load_q_network(folder / WEIGHTS_FILE), policy, observations)
    assert (found.different, found.observations) == (0, len(observations))


@pytest.fixture(scope="module")
def world(runs):
    return world_of("RL-Off", "pbm", runs)


def test_a_rig_chooses_as_the_library_predicts(world, runs, tmp_path):
    agent = train(dqn.make_agent(world, 1, SMALL), SMALL.steps)
    assert agent.num_timesteps == SMALL.steps
    observations = recorded_observations(runs)
    policy = export(dqn.network_of(agent), "RL-Off", observations, FACTS, tmp_path / "p.onnx")
    # Far from what was recorded too, where duties and fans come to their ends.
    seen = np.concatenate([observations, 20.0 * observations])
    expected = agent.predict(seen, deterministic=True)[0]
    chosen = policy.values(seen.astype(float)).argmax(axis=1)
    assert len(np.unique(expected)) > 1
    assert (chosen == expected).all()


def test_all_learn_with_the_same_steps():
    assert {row.settings.steps for row in ALGORITHMS.values()} == {DqnSettings().steps}


def test_an_algorithm_that_is_not_known_is_named():
    with pytest.raises(DataError, match="no 'A3C'; known: DQN, DAgger"):
        algorithm_of("A3C")


def test_trainings_of_an_algorithm_have_a_folder_of_their_own():
    usual = folder_of(POLICIES, "RL-Off", "ham", 0, False)
    assert usual == POLICIES / "rl-off" / "ham" / "seed_0"
    assert folder_of(POLICIES, "RL-Off", "ham", 0, False, "DAgger").parts[-2] == "ham_dagger"


def test_the_highest_score_is_the_nearest_level_also_beyond_the_ends():
    pair = nn.Linear(2, 2)
    with torch.no_grad():
        pair.weight.copy_(torch.eye(2))
        pair.bias.zero_()
    network = dagger.pair_scores(nn.Sequential(), pair)
    duties = torch.tensor([-3.0, 0.0, 0.024, 0.026, 0.5, 0.974, 0.976, 1.0, 40.0])
    for fan in (-0.01, 0.01):
        scores = network(torch.stack([duties, torch.full_like(duties, fan)], dim=1))
        assert scores.shape == (len(duties), ACTIONS)
        levels = [0, 0, 0, 1, 10, 19, 20, 20, 20]
        assert scores.argmax(dim=1).tolist() == [level + LEVELS * (fan > 0) for level in levels]


def test_a_teacher_heats_a_cold_box_and_cools_a_hot_one(world):
    air = np.array([20.0, 34.0])
    rest = np.stack([air, air, np.zeros(2)], axis=1)  # of air, wall and element
    now = BoxesNow(rest, np.zeros(2, dtype=int), np.full(2, 20.0), np.full(2, 27.0), np.zeros(2), np.zeros(2))
    cold, hot = dagger.Teacher(world.model.twins, dagger.DaggerSettings()).actions(now)
    assert (command_of(cold).heater_duty, command_of(cold).fan_on) == (1.0, False)
    assert (command_of(hot).heater_duty, command_of(hot).fan_on) == (0.0, True)


def test_a_pupil_learns_its_teacher_by_heart_and_again_the_same(world):
    """In 12 steps of 2 boxes with the teacher at the wheel, by many passes."""
    short = replace(world, episodes=_Short(world.episodes, 12))
    settings = dagger.DaggerSettings(steps=24, boxes=2, hidden=(64,), passes=400, batch=8)
    first, again = (dagger.learn(short, 3, settings) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), again.parameters(), strict=True))
    boxes, teacher = (
        EpisodeBoxes(short, 2, np.random.default_rng(3)),
        dagger.Teacher(world.model.twins, settings),
    )
    seen, missed = boxes.reset(), []
    for _ in range(12):
        answers = teacher.actions(boxes.now())
        with torch.no_grad():
            chosen = first(torch.from_numpy(seen.astype(np.float32))).argmax(dim=1).numpy()
        missed += [abs(int(a) % LEVELS - int(b) % LEVELS) for a, b in zip(answers, chosen, strict=True)]
        seen = boxes.step(answers).observation
    assert np.mean(missed) < 2.0  # levels of 21; a pupil that has learnt nothing misses by about 10


class _Short:
    """Episodes of fewer steps."""

    def __init__(self, episodes: DrawnEpisodes, steps: int) -> None:
        self._episodes, self.steps = episodes, steps

    def draw(self, rng):
        whole = self._episodes.draw(rng)
        cut = slice(self.steps + 1)
        return replace(whole, reference=whole.reference[cut], ambient=whole.ambient[cut])


def test_a_model_that_cannot_be_planned_in_is_refused(runs):
    model = read_model("lstm")
    assert isinstance(model, LstmModel)
    world = World(model, DrawnEpisodes(runs, START_ROWS), Weights())
    with pytest.raises(DataError, match="DAgger: plans in a linear twin"):
        dagger.learn(world, 0, dagger.DaggerSettings())
