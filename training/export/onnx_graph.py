"""ONNX graphs written node by node: names are given out, constants are shared with the loops' bodies."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, helper

OPSET = 20
_IR_VERSION = 9  # of opset 20; newer ones an older onnxruntime refuses
Shape = Sequence[int | str | None]


def real(name: str, shape: Shape) -> ValueInfoProto:
    """Return a value of 32 bit real numbers; a free size is a name."""
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)


class Graph:
    """Nodes in the order of their making; values are their names."""

    def __init__(self, outer: "Graph | None" = None) -> None:
        self.nodes: list[NodeProto] = []
        self._root: Graph = self if outer is None else outer._root
        self._initializers: dict[str, TensorProto] = {}
        self._count = 0

    def constant(self, value: ArrayLike, dtype: type = np.float32) -> str:
        """Add a constant, outside of any loop."""
        name = self._root._name("constant")
        self._root._initializers[name] = onnx.numpy_helper.from_array(np.array(value, dtype=dtype), name)
        return name

    def integers(self, *values: int) -> str:
        """Add a constant vector of 64 bit integers: sizes, places, axes; one name per content."""
        name = "integers" + "".join(f"_{value}" for value in values)
        array = np.array(values, dtype=np.int64)
        self._root._initializers[name] = onnx.numpy_helper.from_array(array, name)
        return name

    def op(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """Add a node of one output."""
        return self.ops(kind, 1, *inputs, **attributes)[0]

    def ops(self, kind: str, outputs: int, *inputs: str, **attributes: Any) -> list[str]:
        """Add a node of several outputs."""
        names = [self._root._name(kind) for _ in range(outputs)]
        self.nodes.append(helper.make_node(kind, list(inputs), names, **attributes))
        return names

    def rows(self, value: str, first: str, last: str) -> str:
        """Rows first..last-1 of a value; both are vectors of one integer."""
        return self.op("Slice", value, first, last, self.integers(0))

    def give(self, name: str, value: str) -> None:
        """Call a value by the name that an output has."""
        self.nodes.append(helper.make_node("Identity", [value], [name]))

    def include(self, model: ModelProto, inputs: Mapping[str, str]) -> list[str]:
        """Put a whole model in; `inputs` says what its inputs are here. Returns its outputs."""
        prefix = self._root._name("part") + "_"
        part = onnx.compose.add_prefix(model, prefix)
        given = {prefix + name: value for name, value in inputs.items()}
        for node in part.graph.node:
            bare = NodeProto()
            bare.CopyFrom(node)
            bare.ClearField("doc_string")
            bare.ClearField("metadata_props")
            bare.input[:] = [given.get(name, name) for name in node.input]
            self.nodes.append(bare)
        for tensor in part.graph.initializer:
            self._root._initializers[tensor.name] = tensor
        return [given.get(output.name, output.name) for output in part.graph.output]

    def body(
        self, name: str, inputs: Sequence[ValueInfoProto], outputs: Sequence[ValueInfoProto]
    ) -> GraphProto:
        """Return this graph as the body of a loop of the graph that it was made in."""
        return helper.make_graph(self.nodes, name, inputs, outputs)

    def model(
        self, name: str, inputs: Sequence[ValueInfoProto], outputs: Sequence[ValueInfoProto]
    ) -> ModelProto:
        """Return this graph as a checked model without unread constants."""
        read = read_names(self.nodes)
        constants = [tensor for name, tensor in self._initializers.items() if name in read]
        graph = helper.make_graph(self.nodes, name, inputs, outputs, constants)
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=_IR_VERSION
        )
        onnx.checker.check_model(model)
        return model

    def _name(self, kind: str) -> str:
        self._count += 1
        return f"{kind.lower()}_{self._count}"


def read_names(nodes: Sequence[NodeProto]) -> set[str]:
    """Values that the nodes read, and the bodies of loops among them."""
    read: set[str] = set()
    for node in nodes:
        read |= set(node.input)
        for attribute in node.attribute:
            if attribute.type == AttributeProto.GRAPH:
                read |= read_names(attribute.g.node)
    return read
