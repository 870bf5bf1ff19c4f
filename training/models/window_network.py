"""The seam of every network that sees a window: its last 10 rows in, the next air temperature out.

What differs between two networks is `add_layers` and `read`; the scaler, the target (T+, or T+ - T) and the
training are here. `weights.py` lists the networks; the paper's LSTM stands at the end.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from edge.formats.run_file import RecordedRun
from training.data.datasets import Split
from training.data.pairs import scaler, split_all, windows
from training.models.fit_network import Pairs, Progress, fit, make_deterministic

WINDOW = 10
COLUMNS = ("temp_air", "heater_duty", "fan_on")
HIDDEN = 64
DROPOUT = 0.2


@dataclass(frozen=True, slots=True)
class WindowSettings:
    """The paper's values for its LSTM. `min_delta` is of the scaled target's MSE, see `EarlyStopping`."""

    epochs: int = 5000
    learning_rate: float = 1e-3
    batch_size: int = 40
    hidden: int = HIDDEN
    dropout: float = DROPOUT
    min_delta: float = 5e-4
    tolerance: int = 10
    predicts_increment: bool = False  # not the paper's: the network gives T+ - T instead of T+


class WindowNet(nn.Module, ABC):
    """One step ahead from a window; in and out in plain units, the scaler inside.

    Buffers: `mean` and `scale` [3], what the training data say of T, u_h and u_f; `target_mean` and
    `target_scale`, the same of what the network gives: T+, or T+ - T with `predicts_increment` [K].
    """

    kind = "window"  # of the contract on a rig, see `edge.models.contract.FEATURES`
    mean: Tensor
    scale: Tensor
    target_mean: Tensor
    target_scale: Tensor

    def __init__(
        self,
        mean: Tensor,
        scale: Tensor,
        target_mean: float,
        target_scale: float,
        hidden: int = HIDDEN,
        dropout: float = DROPOUT,
        predicts_increment: bool = False,
    ) -> None:
        super().__init__()
        self.hidden = hidden
        self.predicts_increment = predicts_increment
        self.register_buffer("mean", mean.float())
        self.register_buffer("scale", scale.float())
        self.register_buffer("target_mean", torch.tensor(target_mean))
        self.register_buffer("target_scale", torch.tensor(target_scale))
        self.add_layers(hidden, dropout)

    @abstractmethod
    def add_layers(self, hidden: int, dropout: float) -> None:
        """Make the layers as attributes of this module.

        hidden : width, the same number for every network; dropout : share of values, 0..1
        """

    @abstractmethod
    def read(self, scaled: Tensor) -> Tensor:
        """Return the scaled target [B, 1] from scaled windows [B, 10, 3], oldest row first."""

    def forward(self, window: Tensor) -> Tensor:
        """Air temperature one step after the last row.

        window : [B, 10, 3]; row k holds the air temperature [°C] at k and the heater duty and fan state
            that act from k to k + 1
        Returns : [B] [°C]
        """
        target = self.scale_output(window) * self.target_scale + self.target_mean
        return window[:, -1, 0] + target if self.predicts_increment else target

    def scale_output(self, window: Tensor) -> Tensor:
        """Return the network's own output, of mean 0 and variance 1 in the training data, [B]."""
        return self.read((window - self.mean) / self.scale).squeeze(-1)


Net = TypeVar("Net", bound=WindowNet)


def train(
    network_type: type[Net],
    runs: Sequence[RecordedRun],
    seed: int,
    settings: WindowSettings,
    log: Path | None = None,
) -> tuple[Net, Progress]:
    """Fit a network on the training parts of `runs`, stopped by their validation parts.

    log : folder for TensorBoard; None for none
    Errors : DataError for a test run
    """
    return train_on(network_type, split_all(runs), seed, settings, log)


def train_on(
    network_type: type[Net], parts: Split, seed: int, settings: WindowSettings, log: Path | None = None
) -> tuple[Net, Progress]:
    """`train`, on runs that are divided already."""
    make_deterministic(seed)
    inputs, following = windows(parts.train, WINDOW)
    target_mean, target_scale = scaler(torch.from_numpy(_target(inputs, following, settings))[:, None])
    network = network_type(
        *scaler(torch.from_numpy(inputs.reshape(-1, len(COLUMNS)))),
        float(target_mean),
        float(target_scale),
        settings.hidden,
        settings.dropout,
        settings.predicts_increment,
    )
    fitted = _pairs(network, inputs, following, settings)
    validated = _pairs(network, *windows(parts.validate, WINDOW), settings)
    return network, fit(network, network.scale_output, fitted, validated, settings, seed, log)


def _target(inputs: np.ndarray, following: np.ndarray, settings: WindowSettings) -> np.ndarray:
    return following - inputs[:, -1, 0] if settings.predicts_increment else following


def _pairs(network: WindowNet, inputs: np.ndarray, following: np.ndarray, settings: WindowSettings) -> Pairs:
    target = torch.from_numpy(_target(inputs, following, settings)).float()
    scaled = (target - network.target_mean) / network.target_scale
    return Pairs(torch.from_numpy(inputs).float(), scaled)


class LstmNet(WindowNet):
    """Three times LSTM and Linear, dropout between."""

    kind = "lstm"  # a rig before the other networks knows it by this name

    def add_layers(self, hidden: int, dropout: float) -> None:
        """As `WindowNet.add_layers`."""
        self.lstm_1 = nn.LSTM(len(COLUMNS), hidden, batch_first=True)
        self.linear_1 = nn.Linear(hidden, hidden)
        self.lstm_2 = nn.LSTM(hidden, hidden, batch_first=True)
        self.linear_2 = nn.Linear(hidden, hidden)
        self.lstm_3 = nn.LSTM(hidden, hidden, batch_first=True)
        self.linear_3 = nn.Linear(hidden, 1)
        self.dropout = nn.Dropout(dropout)

    def read(self, scaled: Tensor) -> Tensor:
        """As `WindowNet.read`."""
        hidden, _ = self.lstm_1(scaled)
        hidden, _ = self.lstm_2(self.dropout(self.linear_1(hidden)))
        hidden, _ = self.lstm_3(self.dropout(self.linear_2(hidden)))
        found: Tensor = self.linear_3(hidden[:, -1])
        return found
