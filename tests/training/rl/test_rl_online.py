"""Learning on the rig: what is stored, and a learner that is killed and goes on."""

import contextlib
import json
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium import Env

from edge.core.errors import DataError, RequestError
from edge.models.policy_actions import ACTIONS, LEVELS
from edge.models.policy_observation import FEATURES
from edge.sockets.external_proposals import ExternalProposals
from tests.support.broker import wait_for
from tests.support.daemon_process import ROOT
from training.rl import checkpoint
from training.rl.online import (
    CHECKPOINT_FILE,
    DrivenReplayBuffer,
    OnlineJob,
    RigGone,
    SocketEnv,
    TrainingCourse,
    _Keeper,
    make_online_agent,
)
from training.rl.reward import WEIGHTS
from training.rl.settings import OnlineSettings
from training.rl.vec_env import ACTION_SPACE, OBSERVATION_SPACE
from training.rl.virtual_daemon import virtual_daemon

STEPS = 100
KILL_AFTER = 20  # steps, at least
PATIENCE_S = 90.0  # a learner imports torch first
SETTINGS = OnlineSettings(steps=STEPS, hidden=(8,), batch=8, learning_starts=8, updates=1)
JOB = OnlineJob("RL-On-P", 1, "", SETTINGS)


class CountingEnv(Env):
    """An environment without a rig."""

    observation_space, action_space = OBSERVATION_SPACE, ACTION_SPACE
    steps = 0

    def reset(self, *, seed=None, options=None):
        return np.zeros(len(FEATURES), dtype=np.float32), {}

    def step(self, action):
        self.steps += 1
        seen = np.full(len(FEATURES), self.steps / STEPS, dtype=np.float32)
        return seen, -float(action) / ACTIONS, False, False, {"driven_action": int(action), "gap": False}


def question(tick, temp=24.0, duty=0.0, fan=False, previous=None):
    return {
        "tick": tick,
        "features": [0.0] * len(FEATURES),
        "reference_c": 25.0,
        "temp_air_c": temp,
        "last_sent": {"heater_duty": duty, "fan_on": fan},
        "previous": previous,
    }


# one step


class Questions:
    """A daemon that asks these one after the other; what was answered."""

    def __init__(self, path: Path, questions: list[dict]) -> None:
        self.proposals = ExternalProposals(path)
        self.answers: list[dict] = []
        self._thread = threading.Thread(target=self._run, args=(questions,))
        self._thread.start()

    def _run(self, questions: list[dict]) -> None:
        self.proposals.wait_for_client(5.0)
        for one in questions:
            with contextlib.suppress(RequestError):
                self.answers.append(self.proposals.ask(one, 5.0))

    def close(self) -> None:
        self._thread.join()
        self.proposals.close()


def stepped(tmp_path: Path, questions: list[dict], action: int):
    """Return the result of the first step, and the answer to it."""
    path = tmp_path / "external.sock"
    asked = Questions(path, questions)
    env = SocketEnv(path, WEIGHTS["RL-On-P"], reward_scale=1.0, patience_s=5.0)
    try:
        env.reset()
        return env.step(np.int64(action)), asked.answers
    finally:
        env.close()
        asked.close()


def test_a_step_proposes_and_earns_what_the_board_confirmed(tmp_path):
    safety_changed_it = question(2, temp=26.0, duty=0.25, fan=True, previous={"heater_duty": 0.5})
    (_, reward, terminated, truncated, info), answers = stepped(
        tmp_path, [question(1), safety_changed_it], action=10
    )
    assert answers[0] == {"tick": 1, "heater_duty": 0.5, "fan_on": False}
    assert reward == pytest.approx(-(0.5 + 1.0 + 0.5 + 0.1 * 0.25))  # 1 K too warm, fan on, 0.25 of heat
    assert (terminated, truncated) == (False, False)
    assert info["driven_action"] == LEVELS + 5
    assert (info["used"], info["gap"]) == (True, False)


def test_ticks_that_went_by_are_a_gap(tmp_path):
    (_, _, _, _, info), _ = stepped(tmp_path, [question(1), question(4)], action=0)
    assert (info["used"], info["gap"]) == (False, True)


def test_a_rig_that_is_gone_is_told(tmp_path):
    env = SocketEnv(tmp_path / "none.sock", WEIGHTS["RL-On-P"], 1.0, patience_s=0.2)
    with pytest.raises(RigGone, match="no daemon has asked"):
        env.reset()


def test_the_buffer_keeps_what_was_driven_and_nothing_across_a_gap():
    buffer = DrivenReplayBuffer(10, OBSERVATION_SPACE, ACTION_SPACE)
    seen, nothing = np.zeros((1, len(FEATURES))), np.zeros(1)
    buffer.add(seen, seen, np.array([3]), nothing, nothing, [{"driven_action": 7, "gap": False}])
    buffer.add(seen, seen, np.array([3]), nothing, nothing, [{"driven_action": 9, "gap": True}])
    assert buffer.size() == 1
    assert buffer.actions[0, 0] == 7


# checkpoints


def test_an_agent_goes_on_from_its_checkpoint_as_if_nothing_had_been(tmp_path):
    agent = make_online_agent(CountingEnv(), JOB)
    agent.learn(30, reset_num_timesteps=False)
    checkpoint.save(agent, {"told": 1}, tmp_path / "c.pt")
    other = make_online_agent(CountingEnv(), JOB)
    assert checkpoint.restore(other, tmp_path / "c.pt") == {"told": 1}
    for one in (agent, other):
        one._last_obs = None
        one.env.envs[0].unwrapped.steps = 0
        one.env.envs[0].reset()
    assert other.num_timesteps == 30
    drawn = []
    for one in (agent, other):
        checkpoint._set_random_states(one, torch.load(tmp_path / "c.pt", weights_only=True)["random"])
        one.learn(10, reset_num_timesteps=False)
        drawn.append(one.policy.q_net.q_net[0].weight.detach().numpy())
    assert np.array_equal(*drawn)


def test_an_agent_that_explores_nothing_does_what_its_policy_says_from_the_first_step(tmp_path):
    still = replace(SETTINGS, explore_from=0.0, explore_to=0.0, learning_starts=STEPS)
    agent = make_online_agent(CountingEnv(), replace(JOB, settings=still))
    agent.learn(20)
    with torch.no_grad():
        seen = torch.from_numpy(agent.replay_buffer.observations[:20, 0])
        expected = agent.policy.q_net(seen).argmax(dim=1).numpy()
    assert np.array_equal(agent.replay_buffer.actions[:20, 0, 0], expected)


@pytest.mark.parametrize("content", [b"", b"nonsense"])
def test_what_is_no_checkpoint_is_refused(tmp_path, content):
    (tmp_path / "c.pt").write_bytes(content)
    with pytest.raises(DataError, match="not a checkpoint"):
        checkpoint.restore(make_online_agent(CountingEnv(), JOB), tmp_path / "c.pt")


def test_a_checkpoint_of_another_network_is_refused(tmp_path):
    checkpoint.save(make_online_agent(CountingEnv(), JOB), {}, tmp_path / "c.pt")
    wider = replace(JOB, settings=replace(SETTINGS, hidden=(9,)))
    with pytest.raises(DataError, match="not a checkpoint of this agent"):
        checkpoint.restore(make_online_agent(CountingEnv(), wider), tmp_path / "c.pt")


# killed


@contextlib.contextmanager
def learner(socket: Path, out: Path) -> "Iterator[subprocess.Popen[bytes]]":
    words = ["rl-online", "--variant", "RL-On-P", "--steps", str(STEPS), "--seed", "1"]
    where = ["--socket", str(socket), "--out", str(out)]
    process = subprocess.Popen([sys.executable, "-m", "training", *words, *where], cwd=ROOT)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def steps_kept(out: Path) -> int:
    path = out / CHECKPOINT_FILE
    return torch.load(path, weights_only=True)["steps"] if path.exists() else 0


@pytest.mark.timeout(300)
def test_a_learner_that_is_killed_goes_on_and_the_fallback_runs_the_rig_meanwhile(tmp_path):
    folder, out = tmp_path / "rig", tmp_path / "learner"
    folder.mkdir()
    with virtual_daemon(folder, seed=1, speed=600.0) as socket:  # ten ticks a second
        with learner(socket, out) as first:
            wait_for(lambda: steps_kept(out) >= KILL_AFTER, "a checkpoint", PATIENCE_S)
            first.kill()
            assert first.wait(10.0) == -signal.SIGKILL
        kept = steps_kept(out)
        with learner(socket, out) as second:
            assert second.wait(PATIENCE_S) == 0
    record = json.loads((out / "record.json").read_text())
    assert kept < STEPS
    assert record["metrics"]["starts"] == 2
    assert record["metrics"]["steps"] == STEPS
    assert record["metrics"]["used"] > STEPS / 2
    assert {"external", "MPC"} <= deciders(folder / "history.db")


def deciders(database: Path) -> set[str]:
    """Who decided the ticks."""
    with contextlib.closing(sqlite3.connect(database)) as history:
        return {row[0] for row in history.execute("select controller from ticks")}


def test_a_course_begins_with_nothing(tmp_path):
    assert set(asdict(TrainingCourse()).values()) == {0}


def test_a_checkpoint_is_written_at_the_multiples_of_its_period_and_at_the_end(tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr(_Keeper, "_keep", lambda self: saved.append(self.num_timesteps))
    keeper = _Keeper(TrainingCourse(), tmp_path / "checkpoint", OnlineSettings(checkpoint_every=3))
    for keeper.num_timesteps in range(8):
        keeper._on_rollout_start()
    keeper._on_training_end()
    assert saved == [3, 6, 7]
