"""Single steps of the networks as ONNX graphs, by torch's own exporter."""

import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from onnx import ModelProto
from torch import Tensor, nn

from training.export.onnx_graph import OPSET, Graph, real
from training.models.ham import GuardedHamNet, HamNet
from training.models.predictors import Network
from training.models.window_network import COLUMNS, WINDOW, WindowNet

Hybrid = HamNet | GuardedHamNet
HAM_FEATURES = 4  # temp_air, temp_ambient, heater_duty, fan_on
_BATCH = 3  # traced as any number


class HamStep(nn.Module):
    """One step of a state [B, S], column 0 the air temperature; the paper's hybrid has no other."""

    def __init__(self, network: Hybrid) -> None:
        super().__init__()
        self.network = network

    def forward(self, state: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """Return the state one step later; ambient [°C], duty, fan : [B]."""
        if isinstance(self.network, GuardedHamNet):
            guarded: Tensor = self.network(state, ambient, duty, fan)
            return guarded
        after: Tensor = self.network(state[:, 0], ambient, duty, fan)
        return after.unsqueeze(-1)


class GuardedHamStart(nn.Module):
    """The state [1, S] at the last row of measurements [rows, features]; its inputs are not read."""

    def __init__(self, network: GuardedHamNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, window: Tensor) -> Tensor:
        """As `GuardedHamNet.start`, of one window."""
        return self.network.start(*(window[None, :, column] for column in range(HAM_FEATURES)))


def single_step(network: Network) -> ModelProto:
    """One step, for any B, with the output `next`.

    A window network's has the input window [B, 10, 3] and gives [B] [°C]. A hybrid's has state [B, S],
    ambient, duty and fan [B] and gives the next state [B, S], column 0 the air temperature [°C].
    """
    if isinstance(network, WindowNet):
        return _to_onnx(network, {"window": torch.rand(_BATCH, WINDOW, len(COLUMNS))}, batched=True)
    states = network.twin.transition.shape[1] if isinstance(network, GuardedHamNet) else 1
    inputs = {"state": torch.full((_BATCH, states), 25.0)}
    inputs |= {name: torch.rand(_BATCH) for name in ("ambient", "duty", "fan")}
    return _to_onnx(HamStep(network), inputs, batched=True)


def ham_start(network: Hybrid, window: int) -> ModelProto:
    """Return the state [1, S] to step from, `next`, out of measurements `window` [window, features]."""
    if isinstance(network, GuardedHamNet):
        return _to_onnx(
            GuardedHamStart(network), {"window": torch.zeros(window, HAM_FEATURES)}, batched=False
        )
    graph = Graph()
    graph.give("next", graph.op("Slice", "window", graph.integers(window - 1, 0), graph.integers(window, 1)))
    return graph.model("start", [real("window", [window, HAM_FEATURES])], [real("next", [1, 1])])


def _to_onnx(module: nn.Module, inputs: Mapping[str, Tensor], batched: bool) -> ModelProto:
    """batched : the first size of every input may be any."""
    size = {0: torch.export.Dim.DYNAMIC} if batched else None
    with _quiet():
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
    assert program is not None  # only the exporter without dynamo returns none
    return program.model_proto


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the exporter's warnings of unneeded packages and of its own deprecations."""
    logger = logging.getLogger("torch.onnx._internal.exporter._registration")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
