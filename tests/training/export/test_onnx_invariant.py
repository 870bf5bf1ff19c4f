"""A step divided into what is known before the loop and what is not."""

import numpy as np
import onnx
import onnxruntime
from onnx import ModelProto

from edge.core.predictor import Floats
from training.export.ham_graph import divide
from training.export.onnx_graph import Graph, real


def step_graph() -> ModelProto:
    """next = state * exp(-fan) + [duty, number of rows]."""
    graph = Graph()
    kept = graph.op("Exp", graph.op("Neg", "fan"))
    rows = graph.op("Cast", graph.op("Shape", "duty"), to=onnx.TensorProto.FLOAT)
    column = graph.integers(1)
    count = graph.op("Expand", rows, graph.op("Shape", graph.op("Squeeze", "state", column)))
    added = graph.op("Add", "duty", count)
    moved = graph.op("Mul", "state", graph.op("Unsqueeze", kept, column))
    graph.give("next", graph.op("Add", moved, graph.op("Unsqueeze", added, column)))
    inputs = [real("state", ["B", 1]), *(real(name, ["B"]) for name in ("ambient", "duty", "fan"))]
    return graph.model("step", inputs, [real("next", ["B", 1])])


def run(model: ModelProto, feed: dict[str, Floats]) -> list[Floats]:
    session = onnxruntime.InferenceSession(model.SerializeToString())
    values: list[Floats] = session.run(None, {name: one.astype(np.float32) for name, one in feed.items()})
    return values


def kinds(model: ModelProto) -> set[str]:
    return {node.op_type for node in model.graph.node}


def test_what_does_not_depend_on_the_state_is_computed_before() -> None:
    parts = divide(step_graph(), "state")
    assert "Exp" in kinds(parts.before)
    assert "Exp" not in kinds(parts.after)
    assert "Mul" in kinds(parts.after)


def test_inputs_that_the_step_does_not_read_are_not_carried_through_the_loop() -> None:
    assert "ambient" not in {value.name for value in divide(step_graph(), "state").values}


def test_both_parts_together_are_the_step() -> None:
    parts = divide(step_graph(), "state")
    inputs = {"ambient": np.zeros(3), "duty": np.array([0.1, 0.2, 0.3]), "fan": np.array([0.0, 1.0, 2.0])}
    state = np.array([[20.0], [30.0], [40.0]])
    whole = run(step_graph(), {"state": state, **inputs})[0]
    np.testing.assert_allclose(whole[:, 0], [23.1, 30.0 / np.e + 3.2, 40.0 / np.e**2 + 3.3], rtol=1e-6)
    known = dict(zip((value.name for value in parts.values), run(parts.before, inputs), strict=True))
    assert np.array_equal(run(parts.after, {"state": state, **known})[0], whole)
