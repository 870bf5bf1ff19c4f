"""The hybrid's whole rollout as one graph: its step, as torch exports it, in a Scan."""

import numpy as np
from onnx import GraphProto, ModelProto

from training.onnx_graph import Graph, real
from training.onnx_step import HAM_FEATURES, Hybrid, ham_start, single_step


def ham_rollout(network: Hybrid, window: int) -> ModelProto:
    """window [window, 4], ambient [N], controls [B, N, 2], offset [N] -> temps [B, N]."""
    return scanned(ham_start(network, window), single_step(network), window)


def scanned(start: ModelProto, step: ModelProto, window: int) -> ModelProto:
    """The rollout of any model of one step.

    start : from the window to the state [1, S], column 0 the air temperature [°C]
    step : as `single_step` gives it
    """
    states = step.graph.output[0].type.tensor_type.shape.dim[1].dim_value
    graph = Graph()
    (begin,) = graph.include(start, {"window": "window"})
    batch = graph.op("Shape", "controls", start=0, end=1)
    first = graph.op("Expand", begin, graph.op("Concat", batch, graph.integers(states), axis=0))
    in_time = graph.op("Transpose", "controls", perm=[1, 0, 2])
    columns = graph.ops("Split", 2, in_time, axis=2, num_outputs=2)
    duty, fan = (graph.op("Squeeze", column, graph.integers(2)) for column in columns)  # [N, B]
    column = graph.integers(1)
    ambient = graph.op("Expand", graph.op("Unsqueeze", "ambient", column), graph.op("Shape", duty))
    to_air = graph.constant(np.eye(1, states))
    offset = graph.op("Mul", graph.op("Unsqueeze", "offset", column), to_air)  # [N, S]
    body = _body(graph, step, states)
    found = graph.ops("Scan", 2, first, ambient, duty, fan, offset, num_scan_inputs=4, body=body)[1]
    graph.give("temps", graph.op("Transpose", found, perm=[1, 0]))
    inputs = [
        real("window", [window, HAM_FEATURES]),
        real("ambient", ["N"]),
        real("controls", ["B", "N", 2]),
        real("offset", ["N"]),
    ]
    return graph.model("ham_rollout", inputs, [real("temps", ["B", "N"])])


def _body(graph: Graph, step: ModelProto, states: int) -> GraphProto:
    """State [B, S] and a step's inputs -> the next state, and its air temperature [B]."""
    inner = Graph(graph)
    names = ("ambient", "duty", "fan")
    (following,) = inner.include(step, {name: f"{name}_now" for name in ("state", *names)})
    shifted = inner.op("Add", following, "offset_now")
    temp = inner.op("Gather", shifted, graph.constant(0, np.int64), axis=1)
    scanned_inputs = [*(real(f"{name}_now", ["B"]) for name in names), real("offset_now", [states])]
    return inner.body(
        "step",
        [real("state_now", ["B", states]), *scanned_inputs],
        [real(shifted, ["B", states]), real(temp, ["B"])],
    )
