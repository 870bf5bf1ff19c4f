"""DQN beside the paper's way to do it: `python -m bench.dqn`.

The paper's way: one box, each step solved twice by SciPy's RK45 (once without the hybrid's correction, once
with it) with torch's inference between, and an update of 64 after every step. Ours: 16 boxes in one call with
the exact step, one update of 512 a call. Same equations, network, reward, episodes and stable-baselines3,
in one process on one thread; the paper's way is timed over a share of its steps and scaled.
"""

import argparse
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version

from edge.models.policy_actions import ACTIONS

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: CPU time is of one thread

import numpy as np
from torch import nn

from edge.core.errors import DataError
from edge.twin.model import BoxTwin
from edge.twin.reference import rk45_rollout
from edge.twin.twin_file import read_twin_file
from training.data.datasets import training_runs
from training.models.registry import NETWORK_FILE, TWIN_FILE
from training.rl.algorithms.registry import ALGORITHMS, DQN
from training.rl.boxes import START_ROWS, World
from training.rl.command import POLICIES
from training.rl.compare import JUDGED, JUDGED_SEED
from training.rl.episodes import DrawnEpisodes
from training.rl.models import Floats, Indices, StepModel, TwinModel
from training.rl.read_model import ham_over, kept_folder, read_model
from training.rl.reward import WEIGHTS
from training.rl.saved_policy import FOLDERS, WEIGHTS_FILE, read_record
from training.rl.settings import DqnSettings
from training.rl.study import greedy, play
from training.rl.vec_env import BoxesVecEnv
from training.rl.weights import load_q_network

VARIANT = "RL-Off"
STEPS = 100_000
SEEDS = range(5)
OURS = DqnSettings(steps=STEPS)
learn = ALGORITHMS[DQN].learn
# Small batches, small steps; with explore_share as ours one of its five seeds diverges.
PAPER = replace(OURS, boxes=1, updates=1, batch=64, learning_rate=5e-4, explore_share=0.4)
ENV_S = 3.0  # of CPU, for the environments' steps alone
PACKAGES = ("stable-baselines3", "torch", "numpy", "scipy")
BARE = 100  # steps before the first update while a share of a training is timed


class Rk45Twin(TwinModel):
    """The twin as the paper solves it: box by box, with SciPy's defaults."""

    def __init__(self, twin: BoxTwin) -> None:
        super().__init__([twin], "rk45")
        self._twin = twin

    def step(
        self, state: Floats, ambient: Floats, duty: Floats, fan: Floats, source: Floats, variant: Indices
    ) -> Floats:
        """As `TwinModel.step`."""
        after = np.empty_like(state)
        for box, start in enumerate(state):
            here = slice(box, box + 1)
            after[box] = rk45_rollout(
                self._twin, start, duty[here], fan[here], ambient[here], source=float(source[box])
            )[0]
        return after


def paper_model() -> StepModel:
    """Return the hybrid over RK45."""
    folder = kept_folder("ham")
    return ham_over(Rk45Twin(read_twin_file(folder / TWIN_FILE).twin()), folder / NETWORK_FILE)


def world(model: StepModel) -> World:
    """Return the world in which both ways learn."""
    return World(model, DrawnEpisodes(training_runs("interpolation"), START_ROWS), WEIGHTS[VARIANT])


def steps_per_cpu_s(model: StepModel, settings: DqnSettings) -> float:
    """Return the rate of the environment alone, actions at random."""
    env = BoxesVecEnv(world(model), settings.boxes, seed=1)
    rng, done = np.random.default_rng(1), 0
    env.reset()
    began = time.process_time()
    while time.process_time() - began < ENV_S:
        env.step(rng.integers(ACTIONS, size=settings.boxes))
        done += settings.boxes
    return done / (time.process_time() - began)


def cost_of(model: StepModel, settings: DqnSettings, steps: int) -> tuple[float, float]:
    """CPU and wall time [s] of STEPS steps of training, from `steps` of them, all with updates."""
    partial = replace(settings, steps=steps, learning_starts=BARE) if steps < STEPS else settings
    began, cpu = time.perf_counter(), time.process_time()
    learn(world(model), 0, partial)
    scale = STEPS / steps
    return (time.process_time() - cpu) * scale, (time.perf_counter() - began) * scale


def judge(network: nn.Module) -> float:
    """Cost of a step (reward with its sign turned) in fresh episodes."""
    return -play(greedy(network), world(read_model("ham")), JUDGED, JUDGED_SEED).reward


def train_network(settings: DqnSettings, seed: int, steps: int) -> nn.Module:
    """Return a network after a training."""
    return learn(world(read_model("ham")), seed, replace(settings, steps=steps))


def saved_network(seed: int) -> nn.Module:
    """Return the network that `greenhouse-train rl` has saved. Errors:
    DataError for one with other settings
    """
    folder = POLICIES / FOLDERS[VARIANT] / f"seed_{seed}"
    if read_record(folder)["settings"] != json.loads(json.dumps(asdict(OURS) | {"variants": 1})):
        raise DataError(f"{folder}: kept with other settings than the ones here")
    return load_q_network(folder / WEIGHTS_FILE)


def main(words: Sequence[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--share", type=float, default=0.03, help="of the paper's way that is timed")
    parser.add_argument("--seeds", type=int, default=len(SEEDS), help="trainings of the paper's way")
    parser.add_argument("--steps", type=int, default=STEPS, help="of those of the paper's way")
    arguments = parser.parse_args(words)
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    print(f"# python -m bench.dqn {' '.join(sys.argv[1:] if words is None else words)}".rstrip())
    print(f"# Python {platform.python_version()}, {versions}; one thread; times of a shared machine")
    print(
        f"# Of {STEPS} steps of training; the paper's way timed over {arguments.share:.0%} of them, scaled."
    )
    # Imports and caches are no part of the times.
    learn(world(read_model("ham")), 0, replace(OURS, steps=640, learning_starts=BARE))
    print(f"{'':14s}{'env steps/s of CPU':>20s}{'CPU s':>10s}{'wall s':>10s}", flush=True)
    paper_steps = round(arguments.share * STEPS)
    costs = {}
    for name, model, settings, steps in (
        ("paper's way", paper_model(), PAPER, paper_steps),
        ("ours", read_model("ham"), OURS, STEPS),
    ):
        speed, (cpu_s, wall_s) = steps_per_cpu_s(model, settings), cost_of(model, settings, steps)
        costs[name] = cpu_s
        print(f"{name:14s}{speed:20.0f}{cpu_s:10.1f}{wall_s:10.1f}", flush=True)
    ratio = costs["paper's way"] / costs["ours"]
    print(f"ours costs 1/{ratio:.1f} of the CPU time of the paper's way")
    print(f"# Cost of a step in {JUDGED} fresh episodes (0.5 e^2 + |e|, e in K), by seed: of our trainings")
    print("# that are kept, and of the paper's way with the exact step, the same to RK45's tolerance.")
    _tell("ours", (judge(saved_network(seed)) for seed in SEEDS))
    _tell(
        "paper's way", (judge(train_network(PAPER, seed, arguments.steps)) for seed in range(arguments.seeds))
    )


def _tell(name: str, costs: Iterable[float]) -> None:
    """Each as soon as it is known: a training of the paper's way takes minutes."""
    print(f"{name:14s}", end="", flush=True)
    found = []
    for cost in costs:
        found.append(cost)
        print(f"{cost:.3f} ", end="", flush=True)
    spread = f" ± {statistics.stdev(found):.3f}" if len(found) > 1 else ""
    print(f"  mean {statistics.fmean(found):.3f}{spread}", flush=True)


if __name__ == "__main__":
    main()
