"""The hybrid's whole rollout as one graph: its step, as torch exports it, in a Scan over the steps.

The part of a step that depends on its inputs alone is computed once for all steps.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import onnx
from onnx import GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, helper

from training.export.onnx_graph import Graph, read_names, real
from training.export.onnx_step import HAM_FEATURES, Hybrid, ham_start, single_step


@dataclass(frozen=True, slots=True)
class DividedStep:
    """A step in two: `before`, from the inputs to `values`; `after`, from state and those to the result."""

    before: ModelProto
    after: ModelProto
    values: tuple[ValueInfoProto, ...]


def divide(step: ModelProto, state: str) -> DividedStep:
    """Divide a step into the part that needs `state` and the part that is known beforehand."""
    graph = onnx.shape_inference.infer_shapes(step).graph
    inputs = [value for value in graph.input if value.name != state]
    names = {value.name for value in inputs}
    early = _dependents(graph.node, names) - _dependents(graph.node, {state})
    known = {
        value.name: value
        for value in (*graph.value_info, *inputs)
        if value.name in early and value.type.tensor_type.elem_type == TensorProto.FLOAT
    }
    after = _needed_nodes(graph.node, {graph.output[0].name}, {state, *known})
    read = read_names(after)
    values = tuple(value for name, value in known.items() if name in read)
    before = _needed_nodes(graph.node, {value.name for value in values}, names)
    carried = [value for value in graph.input if value.name == state]
    return DividedStep(
        before=_part(step, before, inputs, values),
        after=_part(step, after, [*carried, *values], graph.output),
        values=values,
    )


def _dependents(nodes: Iterable[NodeProto], values: set[str]) -> set[str]:
    """Return these values and all that is computed from them."""
    found = set(values)
    for node in nodes:
        if read_names([node]) & found:
            found |= set(node.output)
    return found


def _needed_nodes(nodes: Sequence[NodeProto], wanted: set[str], given: set[str]) -> list[NodeProto]:
    """Return the nodes that lead from the given to the wanted values."""
    missing, found = wanted - given, []
    for node in reversed(nodes):
        if missing.intersection(node.output):
            missing |= read_names([node]) - given
            found.append(node)
    return found[::-1]


def _part(
    step: ModelProto,
    nodes: Sequence[NodeProto],
    inputs: Sequence[ValueInfoProto],
    outputs: Sequence[ValueInfoProto],
) -> ModelProto:
    graph = helper.make_graph(nodes, "part", inputs, outputs, step.graph.initializer)
    return helper.make_model(graph, opset_imports=step.opset_import, ir_version=step.ir_version)


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
