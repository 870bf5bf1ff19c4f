"""The hybrid's whole rollout as one graph: its step, as torch exports it, in a Scan over the steps."""

import numpy as np
from onnx import GraphProto, ModelProto

from training.export.onnx_graph import Graph, real
from training.export.onnx_invariant import DividedStep, divide
from training.export.onnx_step import HAM_FEATURES, Hybrid, ham_start, single_step


def ham_rollout(network: Hybrid, window: int) -> ModelProto:
    """window [window, 4], ambient [N], controls [B, N, 2], offset [N] -> temps [B, N]."""
    return scan_steps(ham_start(network, window), single_step(network), window)


def scan_steps(start: ModelProto, step: ModelProto, window: int) -> ModelProto:
    """Return the rollout of any model of one step.

    start : from the window to the state [1, S], column 0 the air temperature [°C]
    step : as `single_step` gives it
    """
    states = step.graph.output[0].type.tensor_type.shape.dim[1].dim_value
    graph = Graph()
    (begin,) = graph.include(start, {"window": "window"})
    batch = graph.op("Shape", "controls", start=0, end=1)
    first = graph.op("Expand", begin, graph.op("Concat", batch, graph.integers(states), axis=0))
    to_air = graph.constant(np.eye(1, states))
    offset = graph.op("Mul", graph.op("Unsqueeze", "offset", graph.integers(1)), to_air)  # [N, S]
    # What depends on time alone is computed once for all sequences, before the scan.
    parts = divide(step, "state")
    known = _in_time(graph, parts)
    body = _body(graph, parts, states)
    count = 1 + len(known)
    found = graph.ops("Scan", 2, first, offset, *known, num_scan_inputs=count, body=body)[1]
    graph.give("temps", graph.op("Transpose", found, perm=[1, 0]))
    inputs = [
        real("window", [window, HAM_FEATURES]),
        real("ambient", ["N"]),
        real("controls", ["B", "N", 2]),
        real("offset", ["N"]),
    ]
    return graph.model("ham_rollout", inputs, [real("temps", ["B", "N"])])


def _in_time(graph: Graph, parts: DividedStep) -> list[str]:
    """Return the values of every step that are known beforehand, [N, B, ...] each."""
    by_step = graph.op("Transpose", "controls", perm=[1, 0, 2])
    columns = graph.ops("Split", 2, by_step, axis=2, num_outputs=2)
    duty, fan = (graph.op("Squeeze", column, graph.integers(2)) for column in columns)
    size = graph.op("Shape", duty)  # [N, B]
    ambient = graph.op("Expand", graph.op("Unsqueeze", "ambient", graph.integers(1)), size)
    inputs = {"ambient": ambient, "duty": duty, "fan": fan}
    flat = {name: graph.op("Reshape", value, graph.integers(-1)) for name, value in inputs.items()}
    return [
        graph.op("Reshape", value, graph.op("Concat", size, graph.op("Shape", value, start=1), axis=0))
        for value in graph.include(parts.before, flat)
    ]


def _body(graph: Graph, parts: DividedStep, states: int) -> GraphProto:
    """State [B, S], offset [S], what is known of the step -> the next state, and its air temperature [B]."""
    inner = Graph(graph)
    names = {value.name: f"{value.name}_now" for value in parts.values}
    (following,) = inner.include(parts.after, {"state": "state_now", **names})
    shifted = inner.op("Add", following, "offset_now")
    temp = inner.op("Gather", shifted, graph.constant(0, np.int64), axis=1)
    sizes = [[dim.dim_value for dim in value.type.tensor_type.shape.dim] for value in parts.values]
    known = [real(name, ["B", *size[1:]]) for name, size in zip(names.values(), sizes, strict=True)]
    return inner.body(
        "step",
        [real("state_now", ["B", states]), real("offset_now", [states]), *known],
        [real(shifted, ["B", states]), real(temp, ["B"])],
    )
