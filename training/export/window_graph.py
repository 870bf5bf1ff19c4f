"""The rollout of any network of a window as one graph: its step, as torch exports it, in a Scan.

`lstm_graph.py` has a faster one for the LSTM alone. This one runs the whole window anew in every step, so it
asks nothing of the network.
"""

from onnx import GraphProto, ModelProto

from training.export.onnx_graph import Graph, Shape, real
from training.export.onnx_step import single_step
from training.models.window_network import COLUMNS, WINDOW, WindowNet

_WIDTH = len(COLUMNS)


def window_rollout(network: WindowNet) -> ModelProto:
    """window [10, 3], controls [B, N, 2], offset [N] -> temps [B, N], see `edge.models.contract`."""
    graph = Graph()
    batch = graph.op("Shape", "controls", start=0, end=1)
    size = graph.op("Concat", batch, graph.integers(WINDOW, _WIDTH), axis=0)
    first = graph.op("Expand", "window", size)
    in_time = graph.op("Transpose", "controls", perm=[1, 0, 2])
    body = _body(graph, single_step(network))
    found = graph.ops("Scan", 2, first, in_time, "offset", num_scan_inputs=2, body=body)[1]  # [N, B]
    graph.give("temps", graph.op("Transpose", found, perm=[1, 0]))
    inputs = [real("window", [WINDOW, _WIDTH]), real("controls", ["B", "N", 2]), real("offset", ["N"])]
    return graph.model("window_rollout", inputs, [real("temps", ["B", "N"])])


def _body(graph: Graph, step: ModelProto) -> GraphProto:
    """Window [B, 10, 3], controls [B, 2] and offset [] of a step -> the next window, its temperature [B].

    The last row's duty and fan are the step's own; in the next window's last row they stand until then.
    """
    inner = Graph(graph)
    last, middle, end = (graph.integers(value) for value in (WINDOW - 1, 1, WINDOW))
    first, rows = graph.integers(0), graph.integers(1)
    columns = graph.integers(2)
    now = inner.op("Slice", "window_now", last, end, rows)  # [B, 1, 3]
    temp = inner.op("Slice", now, first, middle, columns)
    control = inner.op("Unsqueeze", "control_now", rows)
    past = inner.op("Slice", "window_now", first, last, rows)
    filled = inner.op("Concat", past, inner.op("Concat", temp, control, axis=2), axis=1)
    (predicted,) = inner.include(step, {"window": filled})
    following = inner.op("Add", predicted, "offset_now")
    shown = inner.op("Identity", following)
    coming = inner.op("Concat", inner.op("Unsqueeze", following, graph.integers(1, 2)), control, axis=2)
    moved = inner.op("Concat", inner.op("Slice", filled, middle, end, rows), coming, axis=1)
    window: Shape = ("B", WINDOW, _WIDTH)
    return inner.body(
        "step",
        [real("window_now", window), real("control_now", ["B", 2]), real("offset_now", [])],
        [real(moved, window), real(shown, ["B"])],
    )
