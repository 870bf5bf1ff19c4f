"""One training of one policy: the network, the file that a rig runs, the record of both.

The file is read back as the rig reads it, golden observations and all, before it counts as written.
"""

import importlib.metadata
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from onnx import ModelProto
from torch import nn

from edge.core.errors import DataError
from edge.formats.atomic_file import write_atomically
from edge.formats.run_file import RecordedRun, data_sha256
from edge.models import policy_contract as contract
from edge.models.onnx_policy import INPUT, OUTPUT, OnnxPolicy, read_policy
from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import FEATURES, table_sha256
from training.data.datasets import training_runs
from training.export.onnx_graph import Graph, real
from training.models.study import versions
from training.rl.algorithms.registry import ALGORITHMS, DQN
from training.rl.boxes import START_ROWS, EpisodeBoxes, World
from training.rl.episodes import DrawnEpisodes, recorded_observations
from training.rl.read_model import REGIME, read_model
from training.rl.reward import WEIGHTS
from training.rl.saved_policy import POLICY_FILE, RECORD_FILE, WEIGHTS_FILE, save_q_network

GOLDEN = 16  # observations, spread over the given ones


def export(
    network: nn.Sequential,
    name: str,
    observations: NDArray[np.float32],
    facts: Mapping[str, Any],
    path: Path,
) -> OnnxPolicy:
    """Write the network to `path`, prove it, and return what the rig will run.

    network : linear layers with ReLU between, [B, features] -> [B, ACTIONS]
    observations : recorded ones [n, features]; the golden ones are among them
    facts : variant, sample_s, model, data_sha256, ... as `edge.models.policy_contract` has them; JSON values
    Errors : DataError for another kind of network, and when the graph misses it
    """
    model = graph_of(network)
    chosen = observations[np.linspace(0, len(observations) - 1, GOLDEN).astype(int)]
    with torch.no_grad():
        values = network(torch.from_numpy(chosen)).numpy()
    software = {name: importlib.metadata.version(name) for name in ("stable-baselines3", "torch", "onnx")}
    document = contract.document_of(chosen, values, {**facts, "software": software})
    model.metadata_props.add(key=contract.KEY, value=json.dumps(document, allow_nan=False))
    write_atomically(path, model.SerializeToString(deterministic=True))
    return read_policy(path, name, facts["sample_s"])


def graph_of(network: nn.Sequential) -> ModelProto:
    """Return the graph of the network alone. Errors: DataError for layers it cannot hold"""
    graph, value = Graph(), INPUT
    for layer in network:
        match layer:
            case nn.Linear():
                weight, bias = layer.weight.detach().numpy(), layer.bias.detach().numpy()
                value = graph.op("Gemm", value, graph.constant(weight), graph.constant(bias), transB=1)
            case nn.ReLU():
                value = graph.op("Relu", value)
            case _:
                raise DataError(f"{type(layer).__name__}: no layer that a policy's graph holds")
    graph.give(OUTPUT, value)
    return graph.model("policy", [real(INPUT, ["B", len(FEATURES)])], [real(OUTPUT, ["B", ACTIONS])])


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
    algorithm : a key of ALGORITHMS; settings : of it, None for those in use
    """

    variant: str
    model: str
    seed: int
    command: str
    variants: int = 1
    algorithm: str = DQN
    settings: Any = None

    @property
    def settings_used(self) -> Any:
        """The job's own, or those that the algorithm is used with."""
        return self.settings or ALGORITHMS[self.algorithm].settings


def study(job: PolicyJob, folder: Path) -> dict[str, Any]:
    """Train, judge on validation episodes in the model itself, write everything into `folder`; the record."""
    runs = training_runs(REGIME)
    world = world_of(job.variant, job.model, runs, job.variants)
    # Both clocks: on a shared machine wall time alone says little.
    began, cpu = time.perf_counter(), time.process_time()
    network = ALGORITHMS[job.algorithm].learn(world, job.seed, job.settings_used)
    wall_s, cpu_s = time.perf_counter() - began, time.process_time() - cpu
    played = validate(network, job.variant, runs, job.model)
    facts = {
        "variant": job.variant,
        "sample_s": SAMPLE_S,
        "model": world.model.name,
        "model_sha256": world.model.sha256,
        "data_sha256": data_sha256(runs),
        "command": job.command,
        "seed": job.seed,
        "settings": asdict(job.settings_used) | {"variants": job.variants},
        "metrics": {"validation": asdict(played)},
    }
    policy = keep(network, facts, runs, folder)
    record = facts | {
        "algorithm": job.algorithm,
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


def validate(network: nn.Module, variant: str, runs: list[RecordedRun], model: str = "ham") -> PlayMeans:
    """Play validation episodes in a model whose parameters are as fitted."""
    return play(greedy(network), world_of(variant, model, runs))


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
