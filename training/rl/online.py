"""Learning on the rig: a process of its own that proposes to the daemon, with safety in front of it.

It can be killed at any time: the fallback decides meanwhile, and the next start goes on from the checkpoint.
"""

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.noise import ActionNoise

from edge.formats.atomic_file import write_atomically
from edge.formats.run_file import data_sha256
from training.data.datasets import training_runs
from training.rl import checkpoint
from training.rl.read_model import REGIME
from training.rl.reward import WEIGHTS
from training.rl.saved_policy import RECORD_FILE
from training.rl.settings import OnlineSettings, learner_arguments
from training.rl.socket_env import SocketEnv
from training.rl.study import SAMPLE_S, keep, software, validate
from training.rl.weights import load_weights

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
            "validation": asdict(validate(agent, job.variant, runs)),
            "mae_k_while_learning": course.absolute_error_k / learnt_from,
            **{name: getattr(course, name) for name in ("starts", "steps", "used", "gaps")},
        },
    }
    policy = keep(agent.policy.q_net.q_net, facts, runs, folder)
    record = facts | {"policy": policy.version, "wall_s": course.wall_s, "versions": software()}
    write_atomically(folder / RECORD_FILE, json.dumps(record, indent=1) + "\n")
    return record
