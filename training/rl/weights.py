"""Weights of a Q-network as a file."""

import pickle
from pathlib import Path

import torch
from torch import Tensor, nn

from edge.core.errors import DataError


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
