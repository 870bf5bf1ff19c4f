"""Trainings of policies as they are kept: a folder each, with weights, the file of the rig and the record."""

import json
import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from edge.core.errors import DataError

WEIGHTS_FILE, POLICY_FILE, RECORD_FILE = "weights.pt", "policy.onnx", "record.json"
FOLDERS = {  # controller -> where its trainings lie, one folder `seed_*` each
    "RL-Off": Path("rl-off/ham"),
    "RL-Off-P": Path("rl-off-p/ham"),
    "RL-On-P": Path("rl-on-p/virtual"),
    "RL-Tr-P": Path("rl-tr-p/virtual"),
}

Record = Mapping[str, Any]


def read_record(folder: Path) -> Record:
    """Read the record of a saved training. Errors: DataError"""
    path = folder / RECORD_FILE
    try:
        record: Record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    return record


def best_folder(folders: Sequence[Path]) -> Path:
    """Return the training with the highest reward in its validation episodes; the rig has no say in it.

    Errors : DataError where there is none
    """
    if not folders:
        raise DataError("no training of a policy is kept")
    return max(folders, key=lambda folder: read_record(folder)["metrics"]["validation"]["reward"])


def save_q_network(network: nn.Sequential, path: Path) -> None:
    """Write the weights. Errors: OSError."""
    torch.save(network.state_dict(), path)


def load_weights(path: Path) -> dict[str, Tensor]:
    """As `save_q_network` has written them. Errors: DataError for what is no such file"""
    try:
        weights = torch.load(path, weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise DataError(f"{path}: not a file of weights: {error}") from error
    if not isinstance(weights, dict) or "0.weight" not in weights:
        raise DataError(f"{path}: not the weights of a Q-network")
    return weights


def load_q_network(path: Path) -> nn.Sequential:
    """Load the network in evaluation mode: linear layers with ReLU between. Errors: DataError"""
    weights = load_weights(path)
    sizes = [tensor.shape for name, tensor in weights.items() if name.endswith(".weight")]
    layers: list[nn.Module] = []
    for out, features in sizes:
        layers += [nn.Linear(features, out), nn.ReLU()]
    network = nn.Sequential(*layers[:-1])
    network.load_state_dict(weights)
    return network.eval()
