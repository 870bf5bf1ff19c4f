"""Settings of a learning algorithm, compared on validation episodes: `python -m training.rl.tune PPO`.

Each of the algorithm's trials learns once, with a seed that no kept policy has, in the model of
`greenhouse-train rl`. Neither the fresh episodes nor the rig of `greenhouse-train rl-compare` have a say.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from edge.core.errors import GreenhouseError
from training.data.datasets import training_runs
from training.rl.algorithms.algorithm import Algorithm
from training.rl.algorithms.registry import algorithm_of
from training.rl.read_model import REGIME
from training.rl.study import validate, world_of

VARIANT, MODEL, SEED = "RL-Off", "ham", 100


def trial_lines(algorithm: Algorithm) -> Iterator[str]:
    """Yield a line for each trial as soon as it is known: MAE [K], reward of a step, CPU time, settings."""
    runs = training_runs(REGIME)
    usual = asdict(algorithm.trials[0])
    for trial in algorithm.trials:
        cpu = time.process_time()
        network = algorithm.learn(world_of(VARIANT, MODEL, runs), SEED, trial)
        cpu_s = time.process_time() - cpu
        played = validate(network, VARIANT, runs, MODEL)
        figures = f"{played.mae_k:8.4f} {played.reward:9.4f} {cpu_s:8.1f}"
        yield f"  {figures}  {_changes(usual, asdict(trial))}"


def _changes(usual: dict[str, Any], trial: dict[str, Any]) -> str:
    changed = ", ".join(f"{name} {value}" for name, value in trial.items() if value != usual[name])
    return changed or "the first one: " + ", ".join(f"{name} {value}" for name, value in usual.items())


def main(words: Sequence[str] | None = None) -> int:
    """0; 2 for an algorithm that is not known or has no trials."""
    parser = argparse.ArgumentParser(prog="python -m training.rl.tune", description=__doc__)
    parser.add_argument("algorithm")
    name = parser.parse_args(words).algorithm
    try:
        algorithm = algorithm_of(name)
    except GreenhouseError as error:
        print(f"python -m training.rl.tune: {error}", file=sys.stderr)
        return 2
    if not algorithm.trials:
        print(f"python -m training.rl.tune: {name} has no trials", file=sys.stderr)
        return 2
    print(f"# python -m training.rl.tune {name}: {VARIANT} in {MODEL}, seed {SEED}, validation episodes")
    print("# MAE [K], reward of a step, CPU time [s], settings that differ from the first")
    for line in trial_lines(algorithm):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
