"""Trained networks as files: the weights, the scaler among them, and what the network is built from."""

import pickle
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import nn

from edge.core.errors import DataError
from edge.twin.geometry import Geometry
from training.models.ham import STEP_S, GuardedHamNet, HamNet
from training.models.predictors import Network
from training.models.twin_step import TwinStep
from training.models.window_network import LstmNet, WindowNet

FORMAT = 1
NETWORKS: Mapping[str, type[WindowNet]] = {  # every network that sees a window, for weights and export
    "lstm": LstmNet,
}
# Kept before a twin in a graph could have a sensor with a bias: it had none.
_SINCE = {"twin.room_shift": torch.zeros(())}


def save_network(network: nn.Module, path: Path, facts: Mapping[str, Any]) -> None:
    """Write `network` with plain facts (JSON values) beside the weights. Errors: OSError."""
    torch.save(
        {
            "format": FORMAT,
            "kind": type(network).__name__,
            "predicts_increment": getattr(network, "predicts_increment", False),
            "hidden": getattr(network, "hidden", None),
            "weights": network.state_dict(),
            "facts": dict(facts),
        },
        path,
    )


def load_network(path: Path) -> tuple[Network, dict[str, Any]]:
    """Load the network in evaluation mode, and its facts. Errors: DataError for an invalid file"""
    try:
        content = torch.load(path, weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise DataError(f"{path}: not a file of weights: {error}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("kind") not in _EMPTY:
        raise DataError(f"{path}: not a network of format {FORMAT} and of {sorted(_EMPTY)}")
    network = _EMPTY[content["kind"]](content)
    earlier = _SINCE if isinstance(network, GuardedHamNet) else {}
    network.load_state_dict({**earlier, **content["weights"]})
    network.eval()
    return network, content["facts"]


def _window_net(network_type: type[WindowNet], content: Mapping[str, Any]) -> WindowNet:
    # Files of the first LSTMs do not name their width.
    hidden = content["hidden"] if "hidden" in content else content["weights"]["linear_1.bias"].shape[0]
    increment = content["predicts_increment"]
    return network_type(torch.zeros(3), torch.ones(3), 0.0, 1.0, hidden, predicts_increment=increment)


def _ham(content: Mapping[str, Any]) -> HamNet:
    hidden = content["weights"]["mlp.0.bias"].shape[0]
    return HamNet(Geometry(), STEP_S, torch.zeros(4), torch.ones(4), 0.0, 1.0, hidden)


def _guarded_net(content: Mapping[str, Any]) -> GuardedHamNet:
    weights = content["weights"]
    return GuardedHamNet(TwinStep(weights["twin.transition"].shape[1]), weights["mlp.0.bias"].shape[0])


_EMPTY: dict[str, Callable[[dict[str, Any]], Network]] = {
    **{network.__name__: partial(_window_net, network) for network in NETWORKS.values()},
    "HamNet": _ham,
    "GuardedHamNet": _guarded_net,
}
