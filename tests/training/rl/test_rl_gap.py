"""Sim-to-real: a policy's figures in its model and on the virtual rig are of the same course."""

import json

import numpy as np
import pytest
from policy_files import policy_file

from edge.controllers.rl import Rl
from edge.core.errors import DataError
from edge.models.onnx_policy import read_policy
from edge.tick.reference import Reference
from training.rl import gap
from training.rl.boxes import START_ROWS
from training.rl.gap import LEAD_STEPS, STEPS, episode_of, gap_of
from training.rl.read_model import read_model
from training.rl.rig import Ticks, run_on_rig
from training.rl.saved_policy import POLICY_FILE, RECORD_FILE


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return read_policy(policy_file(tmp_path_factory.mktemp("policy") / "p.onnx"), "RL-Off")


def ticks(count=LEAD_STEPS + STEPS + 1, decided=True):
    """A box that stands at 25 °C, 1 K below its reference."""
    even = np.ones(count)
    return Ticks(25.0 * even, 24.6 * even, 22.0 * even, 26.0 * even, 0.2 * even, 0.0 * even, even == decided)


def test_the_rig_runs_a_policy_by_its_name(policy):
    course = Reference(np.array([0.0]), np.array([26.0]))
    found = run_on_rig(Rl("RL-Off", policy), course, steps=3, seed=301)
    assert len(found.temp) == 4
    assert found.decided.all()
    assert (found.duty == 0.35).all()  # its favourite where the air is too cold
    assert np.isfinite(found.error_k).all()


def test_an_episode_of_the_model_is_what_the_rig_met_after_its_lead_in():
    count = LEAD_STEPS + STEPS + 1
    rows = np.arange(count, dtype=float)
    met = Ticks(rows, rows, rows + 1000.0, rows + 2000.0, rows + 3000.0, rows + 4000.0, rows >= 0.0)
    episode = episode_of(met)
    assert list(episode.reference) == list(2000.0 + np.arange(LEAD_STEPS, count))
    assert list(episode.ambient) == list(1000.0 + np.arange(LEAD_STEPS, count))
    assert len(episode.start.temp) == START_ROWS
    assert episode.start.temp[-1] == LEAD_STEPS  # the row of the first step, whose inputs are not decided
    assert episode.start.duty[-2] == 3000.0 + LEAD_STEPS - 1


def test_figures_of_the_rig_are_measured_air_against_the_reference_of_the_step(policy, monkeypatch):
    monkeypatch.setattr(gap, "run_on_rig", lambda *_: ticks())
    found = gap_of(policy, read_model("pbm"), seeds=(1, 2))
    assert found.rig_mae_k == pytest.approx(1.0)
    assert found.rig_reward == pytest.approx(-(0.5 + 1.0))
    assert found.model_mae_k > 0.0
    assert found.model_reward < 0.0


def test_a_rig_that_a_fallback_ran_tells_nothing_of_a_policy(policy, monkeypatch):
    monkeypatch.setattr(gap, "run_on_rig", lambda *_: ticks(decided=False))
    with pytest.raises(DataError, match="board 1: a tick was not the policy's"):
        gap_of(policy, read_model("pbm"), seeds=(1,))


def test_the_table_has_a_line_for_each_policy_and_one_for_all(tmp_path, monkeypatch):
    folders = []
    for seed in (0, 1):
        folders.append(tmp_path / f"seed_{seed}")
        folders[-1].mkdir()
        policy_file(folders[-1] / POLICY_FILE)
        record = {"variant": "RL-Off", "seed": seed, "policy": "abc", "command": "greenhouse-train rl"}
        (folders[-1] / RECORD_FILE).write_text(json.dumps(record))
    monkeypatch.setattr(gap, "gap_of", lambda *_: gap.PolicyGap(0.4, 0.5, -0.8, -1.0))
    groups = [("as fitted", folders)]
    lines = list(gap.gap_table(groups, read_model("pbm"), "greenhouse-train rl-gap"))
    assert lines[0] == "# greenhouse-train rl-gap"
    assert [line.split()[:4] for line in lines[-3:]] == [
        ["RL-Off", "as", "fitted", "0"],
        ["RL-Off", "as", "fitted", "1"],
        ["RL-Off", "as", "fitted", "all"],
    ]
    assert "0.100" in lines[-2]
    assert "0.100 ± 0.000" in lines[-1]
    assert len(list(gap.hashes(groups))) == 2
