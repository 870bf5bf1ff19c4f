"""The LSTM's whole rollout as one graph, in a form that is fast on one core.

Each prediction comes from a window of its own, run from a zero state: 10 cells in each of 3 layers that wait
for each other. But the windows overlap, and of each only the last row is not known before. So a row, once
known, is run through all windows that hold it at once, as a batch of 10 B: a step of the rollout is 3 cells
and not 30. The oldest window is then complete and gives the prediction, which is the next row; it leaves, and
a new one begins from zero.

Between layers there is nothing but a linear layer (the dropout is of training alone), so it is multiplied
into the next layer's input weights. Windows that would be complete only after the last step are not begun:
the state shrinks towards the end, which ONNX allows in Loop but not in Scan.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from onnx import GraphProto, ModelProto, TensorProto, ValueInfoProto, helper
from torch import Tensor

from training.export.onnx_graph import Graph, real
from training.models.window_network import LstmNet

Floats = NDArray[np.float64]
_GATE_NAMES = ("input", "forget", "cell", "output")  # torch's order
_GATES = ("Sigmoid", "Sigmoid", "Tanh", "Sigmoid")
_REST = 2**40  # more rows than there are


@dataclass(frozen=True, slots=True)
class _Layer:
    """One cell; its four gates read [x, h] by `weights` [inputs + hidden, hidden] and `biases` [hidden]."""

    weights: tuple[str, ...]
    biases: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Network:
    """Names of the constants.

    scaler : of each column, mean and scale that bring it to the scale of the network
    head : weight [hidden, 1] and bias [1], from the last layer to the target in kelvin
    """

    scaler: tuple[tuple[str, str], ...]
    layers: tuple[_Layer, ...]
    head: tuple[str, str]
    hidden: int
    predicts_increment: bool


@dataclass(frozen=True, slots=True)
class _Steps:
    """Values that the steps of the rollout read by their number, and the batch [1].

    inputs : scaled, [N, B, 2]; zeros : [B, hidden]
    alive : windows that hold the step's row, [N, 1]
    begun : rows of the state that begin with it, B or 0, [N, 1]
    """

    inputs: str
    alive: str
    begun: str
    zeros: str
    batch: str


def lstm_rollout(network: LstmNet, window: int) -> ModelProto:
    """window [window, 3], controls [B, N, 2], offset [N] -> temps [B, N], see `edge.models.contract`."""
    graph = Graph()
    constants = _constants(graph, network)
    columns = [
        graph.op("Slice", "window", graph.integers(0, column), graph.integers(window - 1, column + 1))
        for column in range(3)
    ]
    past = graph.op("Concat", *_scale(graph, constants, columns), axis=1)
    now = graph.op("Slice", "window", graph.integers(window - 1, 0), graph.integers(window, 1))  # [1, 1]
    horizon = graph.op("Shape", "controls", start=1, end=2)
    steps = _steps(graph, constants, horizon, window)
    needed = graph.op("Min", horizon, graph.integers(window - 1))
    states = [
        _for_batch(graph, state, needed, steps.batch, constants.hidden)
        for state in _begin(graph, constants, past, window - 1)
    ]
    first = graph.op("Expand", now, graph.op("Concat", steps.batch, graph.integers(1), axis=0))
    body = _step(graph, constants, steps)
    count = graph.op("Squeeze", horizon)
    found = graph.ops("Loop", len(states) + 2, count, "", first, *states, body=body)[-1]  # [N, B, 1]
    graph.give("temps", graph.op("Transpose", graph.op("Squeeze", found, graph.integers(2)), perm=[1, 0]))
    inputs = [real("window", [window, 3]), real("controls", ["B", "N", 2]), real("offset", ["N"])]
    return graph.model("lstm_rollout", inputs, [real("temps", ["B", "N"])])


def _constants(graph: Graph, network: LstmNet) -> _Network:
    """Return the weights, each linear layer inside the layer after it; multiplied in 64 bits, kept in 32."""
    weight, bias = np.eye(3), np.zeros(3)  # from what the layer before gives to what this one reads
    layers = []
    for number in (1, 2, 3):
        lstm, linear = (getattr(network, f"{kind}_{number}") for kind in ("lstm", "linear"))
        into, again = _numbers(lstm.weight_ih_l0), _numbers(lstm.weight_hh_l0)
        weights = np.concatenate([into @ weight, again], axis=1)
        biases = _numbers(lstm.bias_ih_l0) + _numbers(lstm.bias_hh_l0) + into @ bias
        layers.append(
            _Layer(
                tuple(graph.constant(gate.T) for gate in np.split(weights, len(_GATES))),
                tuple(graph.constant(gate) for gate in np.split(biases, len(_GATES))),
            )
        )
        weight, bias = _numbers(linear.weight), _numbers(linear.bias)
    unit, zero = _numbers(network.target_scale), _numbers(network.target_mean)
    pairs = zip(_numbers(network.mean), _numbers(network.scale), strict=True)
    return _Network(
        scaler=tuple((graph.constant(mean), graph.constant(scale)) for mean, scale in pairs),
        layers=tuple(layers),
        head=(graph.constant(weight.T * unit), graph.constant(bias * unit + zero)),
        hidden=network.lstm_1.hidden_size,
        predicts_increment=network.predicts_increment,
    )


def _numbers(tensor: Tensor) -> Floats:
    return tensor.detach().double().numpy()


def _scale(graph: Graph, network: _Network, columns: list[str], first: int = 0) -> list[str]:
    """Columns of the window, from number `first` on, at the scale of the network."""
    scalers = network.scaler[first : first + len(columns)]
    return [
        graph.op("Div", graph.op("Sub", column, mean), scale)
        for column, (mean, scale) in zip(columns, scalers, strict=True)
    ]


def _steps(graph: Graph, network: _Network, horizon: str, window: int) -> _Steps:
    in_time = graph.op("Transpose", "controls", perm=[1, 0, 2])
    columns = graph.ops("Split", 2, in_time, axis=2, num_outputs=2)
    batch = graph.op("Shape", "controls", start=0, end=1)
    zero, one = (graph.constant(value, np.int64) for value in (0, 1))
    left = graph.op("Sub", horizon, graph.op("Range", zero, graph.op("Squeeze", horizon), one))
    alive = graph.op("Min", left, graph.integers(window))
    begins = graph.op("Cast", graph.op("Equal", alive, graph.integers(window)), to=TensorProto.INT64)
    size = graph.op("Concat", batch, graph.integers(network.hidden), axis=0)
    return _Steps(
        inputs=graph.op("Concat", *_scale(graph, network, columns, first=1), axis=2),
        alive=graph.op("Unsqueeze", alive, graph.integers(1)),
        begun=graph.op("Unsqueeze", graph.op("Mul", begins, batch), graph.integers(1)),
        zeros=graph.op("Expand", graph.constant([[0.0]]), size),
        batch=batch,
    )


def _advance(graph: Graph, network: _Network, value: str, states: list[str]) -> list[str]:
    """Pass a row of every window, [rows, 3], through all layers; states h,
    c of each layer, [rows, hidden].
    """
    following = []
    for number, layer in enumerate(network.layers):
        hidden, cell = states[2 * number : 2 * number + 2]
        seen = graph.op("Concat", value, hidden, axis=1)
        take, keep, new, show = (
            graph.op(kind, graph.op("Gemm", seen, weight, bias))
            for kind, weight, bias in zip(_GATES, layer.weights, layer.biases, strict=True)
        )
        cell = graph.op("Add", graph.op("Mul", keep, cell), graph.op("Mul", take, new))
        value = graph.op("Mul", show, graph.op("Tanh", cell))
        following += [value, cell]
    return following


def _begin(graph: Graph, network: _Network, past: str, rows: int) -> list[str]:
    """States of the windows that the past [rows, 3] has begun, the oldest first, [rows, hidden] each.

    Here every row is known, and a window is a sequence: number j has the rows from j on.
    """
    numbers = np.arange(rows)
    places = np.minimum(numbers[:, None] + numbers, rows - 1)  # those after its end are not read
    value = graph.op("Gather", past, graph.constant(places, np.int64), axis=0)  # [rows, windows, 3]
    lengths = graph.constant(rows - numbers, np.int32)
    states = []
    for layer in network.layers:
        weights = _of_lstm(graph, layer, network.hidden)
        value, *last = graph.ops("LSTM", 3, value, *weights, lengths, hidden_size=network.hidden)
        value = graph.op("Squeeze", value, graph.integers(1))
        states += [graph.op("Squeeze", state, graph.integers(0)) for state in last]
    return states


def _of_lstm(graph: Graph, layer: _Layer, hidden: int) -> tuple[str, str, str]:
    """Return a cell's weights as ONNX's LSTM has them: on x, on h, and two
    biases; the session folds this once.
    """
    order = [_GATE_NAMES.index(name) for name in ("input", "output", "forget", "cell")]
    gates = graph.op("Concat", *(layer.weights[gate] for gate in order), axis=1)
    both = graph.op("Unsqueeze", graph.op("Transpose", gates, perm=[1, 0]), graph.integers(0))
    last, begin, end = graph.integers(2), graph.integers(0), graph.integers(_REST)
    split = graph.integers(-hidden)
    biases = graph.op("Concat", *(layer.biases[gate] for gate in order), axis=0)
    none = graph.constant(np.zeros(4 * hidden))
    return (
        graph.op("Slice", both, begin, split, last),
        graph.op("Slice", both, split, end, last),
        graph.op("Unsqueeze", graph.op("Concat", biases, none, axis=0), graph.integers(0)),
    )


def _for_batch(graph: Graph, state: str, windows: str, batch: str, hidden: int) -> str:
    """Repeat the first `windows` rows of [rows, hidden], each `batch` times: [windows * B, hidden]."""
    kept = graph.op("Unsqueeze", graph.rows(state, graph.integers(0), windows), graph.integers(1))
    size = graph.op("Concat", windows, batch, graph.integers(hidden), axis=0)
    return graph.op("Reshape", graph.op("Expand", kept, size), graph.integers(-1, hidden))


def _step(graph: Graph, network: _Network, steps: _Steps) -> GraphProto:
    """Body of the rollout: temperature [B, 1] and states -> those of the next step, and the temperature."""
    inner = Graph(graph)
    states = [f"step_{i}" for i in range(2 * len(network.layers))]
    inputs, alive, begun, offset = (
        inner.op("Gather", value, "step_row") for value in (steps.inputs, steps.alive, steps.begun, "offset")
    )
    row = inner.op("Concat", *_scale(inner, network, ["temp"]), inputs, axis=1)  # [B, 3]
    # All windows that hold this row advance together: one matrix product a layer, not one a window.
    size = inner.op("Concat", alive, steps.batch, graph.integers(3), axis=0)
    rows = inner.op("Reshape", inner.op("Expand", row, size), graph.integers(-1, 3))
    new = inner.rows(steps.zeros, graph.integers(0), begun)
    following = _advance(inner, network, rows, [inner.op("Concat", state, new, axis=0) for state in states])
    complete = inner.rows(following[-2], graph.integers(0), steps.batch)
    temp = inner.op("Gemm", complete, *network.head)
    if network.predicts_increment:
        temp = inner.op("Add", temp, "temp")
    temp = inner.op("Add", temp, offset)
    kept = [inner.rows(state, steps.batch, graph.integers(_REST)) for state in following]
    shown = inner.op("Identity", temp)
    number = helper.make_tensor_value_info("step_row", TensorProto.INT64, [])
    on, still_on = (
        helper.make_tensor_value_info(name, TensorProto.BOOL, [])
        for name in ("go_on", inner.op("Identity", "go_on"))
    )
    return inner.body(
        "step",
        [number, on, real("temp", ["B", 1]), *_values(states, network)],
        [still_on, real(temp, ["B", 1]), *_values(kept, network), real(shown, ["B", 1])],
    )


def _values(names: list[str], network: _Network) -> list[ValueInfoProto]:
    return [real(name, [None, network.hidden]) for name in names]
