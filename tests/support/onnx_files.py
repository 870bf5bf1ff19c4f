"""ONNX files of a model that anyone can compute: each step adds duty, offset and a tenth of the room."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from onnx import ModelProto

from edge.models import contract
from training.export.onnx_graph import Graph, real

WINDOWS = {"lstm": 3, "window": 3, "ham": 1, "ham_guarded": 3}
TWIN = "ab" * 32


def graph_of(kind: str, window_input: str = "window", output: str = "temps") -> ModelProto:
    """T[b, k] = the window's last temperature + sum up to step k of duty + offset (+ ambient / 10)."""
    rows, features = WINDOWS[kind], len(contract.FEATURES[kind])
    graph = Graph()
    now = graph.op("Slice", window_input, graph.integers(rows - 1, 0), graph.integers(rows, 1))
    duty = graph.op("Squeeze", graph.ops("Split", 2, "controls", axis=2, num_outputs=2)[0], graph.integers(2))
    added = graph.op("Add", duty, "offset")
    inputs = [real(window_input, [rows, features]), real("controls", ["B", "N", 2]), real("offset", ["N"])]
    if "temp_ambient" in contract.FEATURES[kind]:
        added = graph.op("Add", added, graph.op("Mul", "ambient", graph.constant(0.1)))
        inputs.append(real("ambient", ["N"]))
    summed = graph.op("CumSum", added, graph.constant(1, np.int64))
    graph.give(output, graph.op("Add", now, summed))
    return graph.model("sum", inputs, [real(output, ["B", "N"])])


def document_of(kind: str) -> dict[str, Any]:
    """A contract that `graph_of(kind)` keeps."""
    return {
        "contract": 1,
        "kind": kind,
        "features": list(contract.FEATURES[kind]),
        "units": contract.units(kind),
        "sample_s": 60.0,
        "window": WINDOWS[kind],
        "scaler": {"mean": [0.0], "scale": [1.0]},
        "validity": {key: [0.0, 40.0] if key.endswith("_c") else [0.0, 1.0] for key in contract.keys(kind)},
        "tolerance": {"step_k": 1e-4, "rollout_k": 1e-3},
        "golden": [golden(kind, [[0.5, 0.25]]), golden(kind, [[0.5], [1.0]])],
        "twin_sha256": "" if kind in contract.WITHOUT_A_TWIN else TWIN,
        "data_sha256": "0" * 64,
        "command": "greenhouse-train",
        "seed": 0,
        "metrics": {},
        "software": {"torch": "2.13.0"},
    }


def golden(kind: str, duties: list[list[float]]) -> dict[str, Any]:
    """From 20 °C, with a room at 20 °C."""
    rows, features = WINDOWS[kind], len(contract.FEATURES[kind])
    each = np.array(duties) + (0.0 if kind in contract.WITHOUT_A_TWIN else 2.0)
    return {
        "window": np.full((rows, features), 20.0).tolist(),
        "ambient": [20.0] * len(duties[0]),
        "controls": [[[duty, 1.0] for duty in row] for row in duties],
        "temps": (20.0 + each.cumsum(axis=1)).tolist(),
    }


def write_onnx(
    path: Path,
    kind: str = "lstm",
    changed: Mapping[str, Any] | None = None,
    graph: ModelProto | None = None,
    text: str | None = None,
) -> Path:
    """A file at `path`.

    changed : keys of the contract with other values
    text : in place of the contract, "" for no metadata at all
    """
    model = graph_of(kind) if graph is None else graph
    if text is None:
        text = json.dumps(document_of(kind) | dict(changed or {}))
    if text:
        model.metadata_props.add(key=contract.KEY, value=text)
    path.write_bytes(model.SerializeToString())
    return path
