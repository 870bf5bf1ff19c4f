"""Does a rig's file choose as the trained network does: `python -m training.rl.parity [FOLDER...]`.

Without folders: every policy whose weights are saved, the best of each kind. Action for action, on every
observation of the recorded runs. Of equal values both take the first.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from edge.core.errors import GreenhouseError
from edge.models.onnx_policy import OnnxPolicy, read_policy
from training.data.datasets import training_runs
from training.rl.command import POLICIES
from training.rl.episodes import recorded_observations
from training.rl.read_model import REGIME
from training.rl.saved_policy import POLICY_FILE, WEIGHTS_FILE, load_q_network
from training.rl.study import greedy


@dataclass(frozen=True, slots=True)
class Parity:
    """How two ways to run one policy compare."""

    observations: int
    different: int  # of them, where the actions differ
    missed: float  # largest difference of two values


def parity(network: nn.Sequential, policy: OnnxPolicy, observations: NDArray[np.float32]) -> Parity:
    """Compare the network in torch and its ONNX file on each of the observations [n, features]."""
    values = policy.values(observations.astype(np.float64))
    with torch.no_grad():
        expected = network(torch.from_numpy(observations)).numpy()
    different = values.argmax(axis=1) != greedy(network)(observations)
    return Parity(len(observations), int(different.sum()), float(np.abs(values - expected).max()))


def main(folders: Sequence[str], kept: Path = POLICIES) -> int:
    """0; 1 where an action differs, 2 for a folder that holds no policy, or where none is kept."""
    chosen = [Path(folder) for folder in folders] or [
        path.parent for path in sorted(kept.glob(f"*/*/seed_*/{WEIGHTS_FILE}"))
    ]
    if not chosen:
        print(f"python -m training.rl.parity: {kept}: no policy is kept there", file=sys.stderr)
        return 2
    observations = recorded_observations(training_runs(REGIME))
    failed = 0
    for folder in chosen:
        try:
            policy = read_policy(folder / POLICY_FILE, folder.name)
            found = parity(load_q_network(folder / WEIGHTS_FILE), policy, observations)
        except GreenhouseError as error:
            print(f"python -m training.rl.parity: {error}", file=sys.stderr)
            return 2
        failed |= found.different > 0
        print(
            f"{folder}: {found.different} of {found.observations} actions differ, "
            f"values by up to {found.missed:.1e}"
        )
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
