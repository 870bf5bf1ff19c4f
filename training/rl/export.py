"""A trained policy as an ONNX file that carries its contract, see edge/models/policy_contract.py.

The file is read back as the rig reads it, golden observations and all, before it counts as written.
"""

import importlib.metadata
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from onnx import ModelProto
from torch import nn

from edge.core.errors import DataError
from edge.formats.atomic_file import write_atomically
from edge.models import policy_contract as contract
from edge.models.onnx_policy import INPUT, OUTPUT, OnnxPolicy, read_policy
from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import FEATURES
from training.export.onnx_graph import Graph, real

GOLDEN = 16  # observations, spread over the given ones


def export(
    network: nn.Sequential,
    name: str,
    observations: NDArray[np.float32],
    facts: Mapping[str, Any],
    path: Path,
) -> OnnxPolicy:
    """Write the Q-network to `path`, prove it, and return what the rig will run.

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
