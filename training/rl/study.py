"""One training of one policy by deep Q-learning: the network, the file that a rig runs, the record of
both.
"""

import importlib.metadata
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DQN
from stable_baselines3.common.logger import Logger
from torch import nn

from edge.formats.atomic_file import write_atomically
from edge.formats.run_file import RecordedRun, data_sha256
from edge.models.onnx_policy import OnnxPolicy
from edge.models.policy_observation import table_sha256
from training.data.datasets import training_runs
from training.models.study import versions
from training.rl.boxes import START_ROWS, EpisodeBoxes, World
from training.rl.episodes import DrawnEpisodes, recorded_observations
from training.rl.export import export
from training.rl.read_model import REGIME, read_model
from training.rl.reward import WEIGHTS
from training.rl.saved_policy import POLICY_FILE, RECORD_FILE, WEIGHTS_FILE
from training.rl.settings import DqnSettings, learner_arguments
from training.rl.vec_env import BoxesVecEnv
from training.rl.weights import save_q_network

Act = Callable[[NDArray[np.float32]], NDArray[np.int64]]  # observations [B, features] -> actions [B]
VALIDATION_BOXES = 64
VALIDATION_SEED = 20_001  # no training has it


@dataclass(frozen=True, slots=True)
class PlayMeans:
    """Means over all steps of all episodes."""

    mae_k: float  # of the true air against the reference of the step
    reward: float  # of a step
    duty: float
    fan: float


def play(act: Act, world: World, count: int = VALIDATION_BOXES, seed: int = VALIDATION_SEED) -> PlayMeans:
    """One episode in each of `count` boxes; the same seed gives the same rooms and references."""
    boxes = EpisodeBoxes(world, count, np.random.default_rng(seed))
    observation, steps = boxes.reset(), []
    for _ in range(world.episodes.steps):
        steps.append(boxes.step(act(observation.astype(np.float32))))
        observation = steps[-1].observation
    return PlayMeans(
        mae_k=float(np.mean([np.abs(step.error_k) for step in steps])),
        reward=float(np.mean([step.reward for step in steps])),
        duty=float(np.mean([step.duty for step in steps])),
        fan=float(np.mean([step.fan for step in steps])),
    )


def train(world: World, seed: int, settings: DqnSettings) -> DQN:
    """Train a policy for `settings.steps` steps in the world's model."""
    torch.set_num_threads(1)  # the same sums in the same order, on every machine of a kind
    env = BoxesVecEnv(world, settings.boxes, seed, settings.reward_scale)
    agent = make_agent(env, seed, settings)
    agent.learn(settings.steps)
    return agent


def make_agent(env: BoxesVecEnv, seed: int, settings: DqnSettings) -> DQN:
    """Untrained. stable-baselines3 counts `target_update_interval` in environment steps."""
    first, last = settings.learning_rate, settings.final_learning_rate
    agent = DQN(
        "MlpPolicy",
        env,
        learning_rate=lambda left: last + (first - last) * left,
        buffer_size=settings.buffer,
        policy_kwargs={"net_arch": list(settings.hidden), "optimizer_kwargs": {"fused": True}},
        **learner_arguments(settings, seed),
    )
    agent.set_logger(Logger(None, []))  # without one each run leaves a folder in /tmp
    return agent


def greedy(network: nn.Module) -> Act:
    """Return the function that picks the action of the highest value, of equal ones the first."""

    @torch.no_grad()
    def act(observations: NDArray[np.float32]) -> NDArray[np.int64]:
        values = network(torch.from_numpy(observations))
        return np.asarray(values.argmax(dim=1).numpy())

    return act


SAMPLE_S = 60.0


@dataclass(frozen=True, slots=True)
class PolicyJob:
    """The policy to train.

    model : as `training.rl.read_model.read_model`; variants : of it, 1 without randomisation
    """

    variant: str
    model: str
    seed: int
    command: str
    variants: int = 1
    settings: DqnSettings = field(default_factory=DqnSettings)


def study(job: PolicyJob, folder: Path) -> dict[str, Any]:
    """Train, judge on validation episodes in the model itself, write everything into `folder`; the record."""
    runs = training_runs(REGIME)
    world = world_of(job.variant, job.model, runs, job.variants)
    # Both clocks: on a shared machine wall time alone says little.
    began, cpu = time.perf_counter(), time.process_time()
    agent = train(world, job.seed, job.settings)
    wall_s, cpu_s = time.perf_counter() - began, time.process_time() - cpu
    played = validate(agent, job.variant, runs, job.model)
    facts = {
        "variant": job.variant,
        "sample_s": SAMPLE_S,
        "model": world.model.name,
        "model_sha256": world.model.sha256,
        "data_sha256": data_sha256(runs),
        "command": job.command,
        "seed": job.seed,
        "settings": asdict(job.settings) | {"variants": job.variants},
        "metrics": {"validation": asdict(played)},
    }
    policy = keep(agent.policy.q_net.q_net, facts, runs, folder)
    record = facts | {
        "policy": policy.version,
        "table_sha256": table_sha256(),
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "versions": software(),
    }
    write_atomically(folder / RECORD_FILE, json.dumps(record, indent=1) + "\n")
    return record


def world_of(variant: str, model: str, runs: list[RecordedRun], variants: int = 1) -> World:
    """Return the world in which the policies of a variant are trained and judged."""
    return World(read_model(model, variants), DrawnEpisodes(runs, START_ROWS), WEIGHTS[variant])


def validate(agent: DQN, variant: str, runs: list[RecordedRun], model: str = "ham") -> PlayMeans:
    """Play validation episodes in a model whose parameters are as fitted."""
    return play(greedy(agent.policy.q_net), world_of(variant, model, runs))


def keep(network: nn.Sequential, facts: dict[str, Any], runs: list[RecordedRun], folder: Path) -> OnnxPolicy:
    """Write the weights, for a training that goes on from them, and the file that a rig runs."""
    folder.mkdir(parents=True, exist_ok=True)
    save_q_network(network, folder / WEIGHTS_FILE)
    return export(network, facts["variant"], recorded_observations(runs), facts, folder / POLICY_FILE)


def software() -> dict[str, str]:
    """Return the versions that a policy depends on."""
    return versions() | {
        name: importlib.metadata.version(name) for name in ("stable-baselines3", "gymnasium")
    }
