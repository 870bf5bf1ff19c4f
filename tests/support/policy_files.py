"""Policies that anyone can compute: each action's value is linear in the observation."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from onnx import ModelProto

from edge.models import policy_contract as contract
from edge.models.onnx_policy import INPUT, OUTPUT
from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import FEATURES
from training.export.onnx_graph import Graph, real

FACTS: dict[str, Any] = {
    "variant": "RL-Off",
    "sample_s": 60.0,
    "model": "ham",
    "model_sha256": "0" * 64,
    "data_sha256": "0" * 64,
    "command": "greenhouse-train rl",
    "seed": 0,
    "settings": {},
    "metrics": {},
    "software": {"torch": "2.13.0"},
}


def weights_of(favourite: int) -> np.ndarray:
    """[features, ACTIONS]: each action is worth its number times the error, `favourite` 100 K more."""
    weights = np.zeros((len(FEATURES), ACTIONS))
    weights[0] = np.arange(ACTIONS) / 100.0
    weights[0, favourite] += 100.0
    return weights


def document(favourite: int = 7, **facts: Any) -> dict[str, Any]:
    """A contract that `graph(favourite)` keeps."""
    observations = np.eye(len(FEATURES))[:3]
    return contract.document_of(observations, observations @ weights_of(favourite), {**FACTS, **facts})


def graph(favourite: int = 7, features: int = len(FEATURES)) -> ModelProto:
    """The values of `weights_of(favourite)`."""
    made = Graph()
    made.give(OUTPUT, made.op("MatMul", INPUT, made.constant(weights_of(favourite)[:features])))
    return made.model("policy", [real(INPUT, ["B", features])], [real(OUTPUT, ["B", ACTIONS])])


def write(path: Path, model: ModelProto, contract_document: dict[str, Any] | None) -> Path:
    """A file with this contract; None for none."""
    if contract_document is not None:
        model.metadata_props.add(key=contract.KEY, value=json.dumps(contract_document))
    path.write_bytes(model.SerializeToString())
    return path


def policy_file(path: Path, favourite: int = 7, **facts: Any) -> Path:
    """A policy that takes `favourite` wherever the air is too cold."""
    return write(path, graph(favourite), document(favourite, **facts))
