"""The LSTM of the paper (tab:method-model-parameters-lstm), one step ahead from a window of 10."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from edge.formats.run_file import RecordedRun
from training.data.datasets import Split
from training.data.pairs import scaler, split_all, windows
from training.models.fit_network import Pairs, Progress, fit, make_deterministic

WINDOW = 10
HIDDEN = 64
DROPOUT = 0.2


@dataclass(frozen=True, slots=True)
class LstmSettings:
    """The paper's values. `min_delta` is of the MSE of the scaled target, see `EarlyStopping`."""

    epochs: int = 5000
    learning_rate: float = 1e-3
    batch_size: int = 40
    hidden: int = HIDDEN
    dropout: float = DROPOUT
    min_delta: float = 5e-4
    tolerance: int = 10
    predicts_increment: bool = False  # not the paper's: the network gives T+ - T instead of T+


class LstmNet(nn.Module):
    """Three times LSTM and Linear, dropout between; in and out in plain units, the scaler inside.

    Buffers: `mean` and `scale` [3], what the training data say of T, u_h and u_f; `target_mean` and
    `target_scale`, the same of what the network gives: T+, or T+ - T with `predicts_increment` [K].
    """

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
        self.predicts_increment = predicts_increment
        self.register_buffer("mean", mean.float())
        self.register_buffer("scale", scale.float())
        self.register_buffer("target_mean", torch.tensor(target_mean))
        self.register_buffer("target_scale", torch.tensor(target_scale))
        self.lstm_1 = nn.LSTM(3, hidden, batch_first=True)
        self.linear_1 = nn.Linear(hidden, hidden)
        self.lstm_2 = nn.LSTM(hidden, hidden, batch_first=True)
        self.linear_2 = nn.Linear(hidden, hidden)
        self.lstm_3 = nn.LSTM(hidden, hidden, batch_first=True)
        self.linear_3 = nn.Linear(hidden, 1)
        self.dropout = nn.Dropout(dropout)

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
        hidden, _ = self.lstm_1((window - self.mean) / self.scale)
        hidden, _ = self.lstm_2(self.dropout(self.linear_1(hidden)))
        hidden, _ = self.lstm_3(self.dropout(self.linear_2(hidden)))
        found: Tensor = self.linear_3(hidden[:, -1])
        return found.squeeze(-1)


def train(
    runs: Sequence[RecordedRun], seed: int, settings: LstmSettings, log: Path | None = None
) -> tuple[LstmNet, Progress]:
    """Fit the network on the training parts of `runs`, stopped by their validation parts.

    log : folder for TensorBoard; None for none
    Errors : DataError for a test run
    """
    return train_on(split_all(runs), seed, settings, log)


def train_on(
    parts: Split, seed: int, settings: LstmSettings, log: Path | None = None
) -> tuple[LstmNet, Progress]:
    """`train`, on runs that are divided already."""
    make_deterministic(seed)
    inputs, following = windows(parts.train, WINDOW)
    target_mean, target_scale = scaler(torch.from_numpy(_target(inputs, following, settings))[:, None])
    network = LstmNet(
        *scaler(torch.from_numpy(inputs.reshape(-1, 3))),
        float(target_mean),
        float(target_scale),
        settings.hidden,
        settings.dropout,
        settings.predicts_increment,
    )
    fitted = _pairs(network, inputs, following, settings)
    validated = _pairs(network, *windows(parts.validate, WINDOW), settings)
    return network, fit(network, network.scale_output, fitted, validated, settings, seed, log)


def _target(inputs: np.ndarray, following: np.ndarray, settings: LstmSettings) -> np.ndarray:
    return following - inputs[:, -1, 0] if settings.predicts_increment else following


def _pairs(network: LstmNet, inputs: np.ndarray, following: np.ndarray, settings: LstmSettings) -> Pairs:
    target = torch.from_numpy(_target(inputs, following, settings)).float()
    scaled = (target - network.target_mean) / network.target_scale
    return Pairs(torch.from_numpy(inputs).float(), scaled)
