"""Learning algorithms: a rig's file chooses as the deterministic choice of the library that has learnt it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from edge.core.errors import DataError
from edge.models.policy_actions import ACTIONS, LEVELS, command_of
from training.data.datasets import training_runs
from training.rl.algorithms import dagger, dqn
from training.rl.algorithms.algorithm import train
from training.rl.algorithms.registry import ALGORITHMS, algorithm_of
from training.rl.boxes import START_ROWS, BoxesNow, EpisodeBoxes, World
from training.rl.command import POLICIES, folder_of
from training.rl.episodes import DrawnEpisodes, recorded_observations
from training.rl.models import LstmModel
from training.rl.read_model import read_model
from training.rl.reward import Weights
from training.rl.settings import DqnSettings
from training.rl.study import export, world_of

FACTS = {
    "variant": "RL-Off", "sample_s": 60.0, "model": "pbm", "model_sha256": "", "data_sha256": "",
    "command": "", "seed": 0, "settings": {}, "metrics": {},
}  # fmt: skip
SMALL = DqnSettings(steps=480, hidden=(16,), batch=16, learning_starts=64)


@pytest.fixture(scope="module")
def runs():
    return training_runs("interpolation")


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
