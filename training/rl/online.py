"""Learning on the rig: a process of its own that proposes to the daemon, with safety in front of it.

It can be killed at any time: the fallback decides meanwhile, and the next start goes on from the checkpoint.
"""

import json
import select
import socket
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DQN
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.noise import ActionNoise

from edge.core.errors import GreenhouseError
from edge.core.messages import Command
from edge.formats.atomic_file import write_atomically
from edge.formats.reader import parse_json
from edge.formats.run_file import data_sha256
from edge.models.policy_actions import action_of, command_of
from training.data.datasets import training_runs
from training.rl import checkpoint
from training.rl.read_model import REGIME
from training.rl.reward import WEIGHTS, Weights, reward
from training.rl.saved_policy import RECORD_FILE, load_weights
from training.rl.settings import OnlineSettings, learner_arguments
from training.rl.study import SAMPLE_S, keep, software, validate
from training.rl.vec_env import ACTION_SPACE, OBSERVATION_SPACE

Observation = NDArray[np.float32]
RETRY_S = 0.1
_CHUNK = 65536


class RigGone(GreenhouseError):
    """No daemon asks at the socket."""


class SocketEnv(gymnasium.Env[Observation, np.int64]):
    """`step` proposes an action and waits for the next tick.

    The reward is that of the command which the board confirmed, on the filtered air temperature at the end of
    the step. `info` holds `driven_action`, the action that comes nearest to that command; `used`, whether
    the daemon took the proposal; `gap`, whether ticks went by unasked, so that nothing can be learnt.

    patience_s : without a question; then RigGone
    """

    metadata = {"render_modes": []}  # noqa: RUF012
    observation_space = OBSERVATION_SPACE
    action_space = ACTION_SPACE

    def __init__(self, path: Path, weights: Weights, reward_scale: float, patience_s: float = 600.0) -> None:
        self._path, self._weights, self._scale = path, weights, reward_scale
        self._patience_s = patience_s
        self._line: _Line | None = None
        self._question: Mapping[str, Any] = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Wait for a tick; the rig goes on as it is."""
        super().reset(seed=seed)
        self._question, _ = self._next()
        return _observation(self._question), {}

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Never the end of an episode."""
        before, command = self._question, command_of(int(action))
        answer = {"tick": before["tick"], "heater_duty": command.heater_duty, "fan_on": command.fan_on}
        if self._line is not None:
            self._line.send(answer)
        self._question, same_line = self._next()
        sent = self._question["last_sent"]
        driven = Command(heater_duty=sent["heater_duty"], fan_on=sent["fan_on"])
        error = np.array(self._question["temp_air_c"] - before["reference_c"])
        earned = reward(error, np.array(driven.heater_duty), np.array(float(driven.fan_on)), self._weights)
        info = {
            "driven_action": action_of(driven),
            "used": self._question["previous"] is not None,
            "gap": not same_line or self._question["tick"] != before["tick"] + 1,
            "error_k": float(error),
        }
        return _observation(self._question), float(self._scale * earned), False, False, info

    def close(self) -> None:
        """Hang up; the fallback decides from the next tick on."""
        if self._line is not None:
            self._line.close()
            self._line = None

    def _next(self) -> tuple[Mapping[str, Any], bool]:
        """Return the next question, and whether it came over the same connection as the one before."""
        give_up_s = time.monotonic() + self._patience_s
        same_line = True
        while time.monotonic() < give_up_s:
            if self._line is None:
                same_line = False
                self._line = _Line.to(self._path)
            question = None if self._line is None else self._line.newest(give_up_s)
            if question is not None:
                return question, same_line
            self.close()
            time.sleep(RETRY_S)
        raise RigGone(f"{self._path}: no daemon has asked for {self._patience_s:g} s")


class _Line:
    """One connection."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._unread = connection, b""

    @classmethod
    def to(cls, path: Path) -> "_Line | None":
        """None while no daemon listens."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.connect(str(path))
        except OSError:
            connection.close()
            return None
        return cls(connection)

    def newest(self, give_up_s: float) -> Mapping[str, Any] | None:
        """Return the newest question, None when the daemon has hung up or is silent."""
        while b"\n" not in self._unread or self._is_readable(0.0):
            if not self._is_readable(give_up_s - time.monotonic()):
                return None
            try:
                data = self._connection.recv(_CHUNK)
            except OSError:
                data = b""
            if not data:
                return None
            self._unread += data
        *lines, self._unread = self._unread.split(b"\n")
        question = parse_json(lines[-1], "question")
        if "refused" in question:
            raise RigGone(f"refused: {question['refused']}")
        return question

    def send(self, answer: Mapping[str, Any]) -> None:
        """Send an answer. The wait for the next question notices a daemon that has ended."""
        try:
            self._connection.sendall(json.dumps(answer).encode() + b"\n")
        except OSError:
            return

    def close(self) -> None:
        self._connection.close()

    def _is_readable(self, timeout_s: float) -> bool:
        return bool(select.select([self._connection], [], [], max(0.0, timeout_s))[0])


def _observation(question: Mapping[str, Any]) -> Observation:
    return np.array(question["features"], dtype=np.float32)


CHECKPOINT_FILE = "checkpoint.pt"


class DrivenReplayBuffer(ReplayBuffer):
    """Keeps `driven_action` of the infos in place of the action, and nothing across a gap."""

    def add(
        self,
        obs: np.ndarray,
        next_obs: np.ndarray,
        action: np.ndarray,
        reward: np.ndarray,
        done: np.ndarray,
        infos: list[dict[str, Any]],
    ) -> None:
        """One step of the one rig there is."""
        if infos[0]["gap"]:
            return
        super().add(obs, next_obs, np.array([infos[0]["driven_action"]]), reward, done, infos)


@dataclass(frozen=True, slots=True)
class OnlineJob:
    """The policy to learn.

    begin_with : weights of a policy that was trained offline; None begins from nothing
    where : "rig", or "virtual board"
    """

    variant: str
    seed: int
    command: str
    settings: OnlineSettings
    begin_with: Path | None = None
    where: str = "rig"
    patience_s: float = 600.0


@dataclass(slots=True)
class TrainingCourse:
    """The course so far, over all starts of the process."""

    starts: int = 0
    steps: int = 0
    used: int = 0  # of the steps, where the daemon took the proposal
    gaps: int = 0  # of the steps, those that nothing is learnt from: ticks went by before them
    absolute_error_k: float = 0.0  # summed over the steps that are no gaps
    wall_s: float = 0.0


def learn_online(job: OnlineJob, socket: Path, folder: Path) -> dict[str, Any]:
    """Propose until all steps are done, export the policy, keep the record in `folder`; the record.

    Errors : DataError for a checkpoint or weights that don't fit; RigGone when nobody asks
    """
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    settings, path, course = job.settings, folder / CHECKPOINT_FILE, TrainingCourse()
    env = SocketEnv(socket, WEIGHTS[job.variant], settings.reward_scale, job.patience_s)
    try:
        agent = make_online_agent(env, job)
        if path.exists():
            course = TrainingCourse(**checkpoint.restore(agent, path))
        course.starts += 1
        left = settings.steps - agent.num_timesteps
        if left > 0:
            agent.learn(left, callback=_Keeper(course, path, settings), reset_num_timesteps=False)
    finally:
        env.close()
    return _finish(agent, job, course, folder)


def make_online_agent(env: SocketEnv, job: OnlineJob) -> DQN:
    """At its first step, with the weights that it begins with."""
    settings = job.settings
    agent = OnlineDqn(
        "MlpPolicy",
        env,
        learning_rate=settings.learning_rate,
        buffer_size=settings.steps,
        replay_buffer_class=DrivenReplayBuffer,
        policy_kwargs={"net_arch": list(settings.hidden)},
        **learner_arguments(settings, job.seed),
    )
    agent.set_logger(Logger(None, []))  # without one each run leaves a folder in /tmp
    if job.begin_with is not None:
        weights = load_weights(job.begin_with)
        for network in (agent.policy.q_net, agent.policy.q_net_target):
            network.q_net.load_state_dict(weights)
    return agent


class OnlineDqn(DQN):
    """Acts by its policy from the first step on: what it has learnt offline counts before it learns more.

    stable-baselines3 takes random actions until `learning_starts`; here that is left to the exploration.
    """

    def _sample_action(
        self, learning_starts: int, action_noise: ActionNoise | None = None, n_envs: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        return super()._sample_action(0, action_noise, n_envs)


class _Keeper(BaseCallback):
    """Counts, and writes a checkpoint between two steps."""

    def __init__(self, course: TrainingCourse, path: Path, settings: OnlineSettings) -> None:
        super().__init__()
        self._course, self._path, self._settings = course, path, settings
        self._since = time.perf_counter()

    def _on_rollout_start(self) -> None:
        if self.num_timesteps and self.num_timesteps % self._settings.checkpoint_every == 0:
            self._keep()

    def _on_training_end(self) -> None:
        self._keep()

    def _keep(self) -> None:
        now = time.perf_counter()
        self._course.wall_s += now - self._since
        self._since = now
        assert isinstance(self.model, DQN)
        checkpoint.save(self.model, asdict(self._course), self._path)

    def _on_step(self) -> bool:
        info = self.locals["infos"][0]
        course = self._course
        course.steps += 1
        course.used += info["used"]
        course.gaps += info["gap"]
        course.absolute_error_k += 0.0 if info["gap"] else abs(info["error_k"])
        return True


def _finish(agent: DQN, job: OnlineJob, course: TrainingCourse, folder: Path) -> dict[str, Any]:
    runs = training_runs(REGIME)
    learnt_from = max(1, course.steps - course.gaps)
    facts = {
        "variant": job.variant,
        "sample_s": SAMPLE_S,
        "model": job.where,
        "model_sha256": "",
        "data_sha256": data_sha256(runs),
        "command": job.command,
        "seed": job.seed,
        "settings": asdict(job.settings) | {"begin_with": str(job.begin_with or "")},
        "metrics": {
            "validation": asdict(validate(agent.policy.q_net, job.variant, runs)),
            "mae_k_while_learning": course.absolute_error_k / learnt_from,
            **{name: getattr(course, name) for name in ("starts", "steps", "used", "gaps")},
        },
    }
    policy = keep(agent.policy.q_net.q_net, facts, runs, folder)
    record = facts | {"policy": policy.version, "wall_s": course.wall_s, "versions": software()}
    write_atomically(folder / RECORD_FILE, json.dumps(record, indent=1) + "\n")
    return record
