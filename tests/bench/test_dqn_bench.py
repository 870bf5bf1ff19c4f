"""The DQN benchmark's stand-in for the paper: the same box, solved the slow way."""

import numpy as np

from bench.dqn import paper_model, world
from training.rl.boxes import EpisodeBoxes
from training.rl.read_model import read_model


def test_the_papers_way_steps_the_same_box():
    ways = [
        EpisodeBoxes(world(model), 2, np.random.default_rng(0))
        for model in (paper_model(), read_model("ham"))
    ]
    for way in ways:
        way.reset()
    for action in (0, 10, 20, 41, 25):
        slow, exact = (way.step(np.array([action, 41 - action])).error_k for way in ways)
        assert np.abs(slow - exact).max() < 2e-3  # SciPy's default tolerance
