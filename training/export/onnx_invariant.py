"""Invariant part of a step, computed from its inputs alone, taken out of the loop over the steps.

The inputs of all steps are known beforehand, and each row of a batch is computed for itself. So what depends
on the inputs and not on the state is computed once, for the rows of all steps together.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import onnx
from onnx import ModelProto, NodeProto, TensorProto, ValueInfoProto, helper

from training.export.onnx_graph import read_names


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
