"""The hybrid's whole rollout as one graph: its step as torch exports it, in a Scan."""

import logging
import warnings

import numpy as np
import torch
from onnx import GraphProto, ModelProto
from torch import Tensor, nn

from training.ham import HamNet
from training.ham_guarded import GuardedHamNet
from training.onnx_graph import OPSET, Graph, real

FEATURES = 4  # temp_air, temp_ambient, heater_duty, fan_on
Hybrid = HamNet | GuardedHamNet


class HamStep(nn.Module):
    """One step of a state [B, S], column 0 the air temperature; the paper's hybrid has no other."""

    def __init__(self, network: Hybrid) -> None:
        super().__init__()
        self.network = network

    def forward(self, state: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """The state one step later; ambient [°C], duty, fan : [B]."""
        if isinstance(self.network, GuardedHamNet):
            return self.network(state, ambient, duty, fan)
        return self.network(state[:, 0], ambient, duty, fan).unsqueeze(-1)


class HamStart(nn.Module):
    """The state [1, S] at the last row of measurements [rows, features]."""

    def __init__(self, network: Hybrid) -> None:
        super().__init__()
        self.network = network

    def forward(self, window: Tensor) -> Tensor:
        """The last row's inputs are not read."""
        if isinstance(self.network, GuardedHamNet):
            return self.network.start(*(window[None, :, column] for column in range(FEATURES)))
        return window[-1:, :1]


def ham_rollout(network: Hybrid, window: int) -> ModelProto:
    """window [window, 4], ambient [N], controls [B, N, 2], offset [N] -> temps [B, N]."""
    start = to_onnx(HamStart(network), {"window": torch.zeros(window, FEATURES)}, batched=False)
    return scanned(start, ham_step(network), window)


def ham_step(network: Hybrid) -> ModelProto:
    """A single step: state [B, S], ambient, duty, fan [B] -> next [B, S]."""
    states = network.twin.transition.shape[1] if isinstance(network, GuardedHamNet) else 1
    batch = 3  # traced as any number
    inputs = {"state": torch.full((batch, states), 25.0)}
    inputs |= {name: torch.rand(batch) for name in ("ambient", "duty", "fan")}
    return to_onnx(HamStep(network), inputs, batched=True)


def to_onnx(module: nn.Module, inputs: dict[str, Tensor], batched: bool) -> ModelProto:
    """`module` as torch exports it, with the output `next`; batched : the first size may be any."""
    size = {0: torch.export.Dim.DYNAMIC} if batched else None
    noise = logging.getLogger("torch.onnx"), logging.getLogger("torch.onnx._internal.exporter._registration")
    for logger in noise:
        logger.setLevel(logging.ERROR)  # it misses packages that nobody asked for
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # torch about itself
        program = torch.onnx.export(
            module.eval(),
            tuple(inputs.values()),
            dynamo=True,
            verbose=False,
            opset_version=OPSET,
            input_names=list(inputs),
            output_names=["next"],
            dynamic_shapes=tuple(size for _ in inputs),
        )
    return program.model_proto


def scanned(start: ModelProto, step: ModelProto, window: int) -> ModelProto:
    """The rollout of any model of one step.

    start : from the window to the state [1, S], column 0 the air temperature; step : as `ham_step` gives it
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
        real("window", [window, FEATURES]),
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
