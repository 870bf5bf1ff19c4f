"""One training of one policy: the network, the file that a rig runs, and the record of both."""

import importlib.metadata
import json
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from stable_baselines3 import DQN
from torch import nn

from edge.formats.atomic_file import write_atomically
from edge.formats.run_file import RecordedRun, data_sha256
from edge.models.onnx_policy import OnnxPolicy
from edge.models.policy_observation import table_sha256
from training.data.datasets import training_runs
from training.models.study import versions
from training.rl.boxes import START_ROWS, World
from training.rl.episodes import DrawnEpisodes
from training.rl.export import export
from training.rl.observations import recorded_observations
from training.rl.play import PlayMeans, play
from training.rl.read_model import REGIME, read_model
from training.rl.reward import WEIGHTS
from training.rl.saved_policy import POLICY_FILE, RECORD_FILE, WEIGHTS_FILE
from training.rl.settings import DqnSettings
from training.rl.train import greedy, train
from training.rl.weights import save_q_network

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
