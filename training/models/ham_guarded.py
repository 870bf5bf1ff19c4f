"""Our HAM, beyond the paper: CoSTA over a fitted twin, and no correction where there were no data.

The base is `edge.twin` with effects whose parameters are fitted on the training runs; its state is the air
and what the board doesn't measure (heat of the heater's element, temperature of the walls). Over one step,
exactly, with the inputs constant:

    x+ = A x + B (u_h, T_amb, r)

As in CoSTA it is solved with r = 0 for T_hat, the network gives r, and it is solved again. r fades to 0
within a margin around the box of the training data: outside it the model is the fitted twin and nothing else.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from edge.formats.run_file import RecordedRun
from edge.twin.model import BoxTwin
from training.data.datasets import Split
from training.data.pairs import scaler, split_all, stretches
from training.models.fit_network import Pairs, Progress, fit, make_deterministic
from training.models.ham import DROPOUT, HIDDEN, source_network
from training.models.twin_step import TwinStep

FEATURES = 4
SETTLING_ROWS = 10  # of a stretch: its hidden states begin at a guess, nothing is learnt from these


@dataclass(frozen=True, slots=True)
class GuardedHamSettings:
    """The paper's values for its HAM, and the guard. `min_delta` is of the MSE of the scaled r."""

    epochs: int = 1000
    learning_rate: float = 1e-3
    batch_size: int = 64
    hidden: int = HIDDEN
    dropout: float = DROPOUT
    min_delta: float = 5e-4
    tolerance: int = 10
    margin: tuple[float, float, float, float] = (0.5, 0.5, 0.05, 0.5)  # of T, T_amb [K], duty, fan


class GuardedHamNet(nn.Module):
    """One step of a state [B, S], column 0 the air [°C]; twin, scaler and validity box inside.

    Buffers of 4 belong to (T [°C], T_amb [°C], duty, fan): `low` and `high` of the training data, `margin`,
    over which the correction fades. `mean` and `scale` [4] belong to (T_hat, T_amb, duty, fan), and
    `source_scale` to r.
    """

    twin: TwinStep
    mean: Tensor
    scale: Tensor
    low: Tensor
    high: Tensor
    margin: Tensor
    source_scale: Tensor

    def __init__(self, twin: TwinStep, hidden: int = HIDDEN, dropout: float = DROPOUT) -> None:
        super().__init__()
        self.twin = twin
        for name in ("mean", "low", "high"):
            self.register_buffer(name, torch.zeros(FEATURES))
        for name in ("scale", "margin"):
            self.register_buffer(name, torch.ones(FEATURES))
        self.register_buffer("source_scale", torch.ones(()))
        self.mlp = source_network(hidden, dropout)

    def start(self, temp: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """Return the state at the last row of a window of measurements, all [B,
        rows]; the last inputs are not read.

        Returns : [B, S]
        """
        return self.twin.start(temp, ambient, duty, fan)

    def forward(self, state: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """Return the state one step later.

        state : [B, S]; ambient [°C], duty 0..1, fan 0 or 1 (or the share of the step) : [B]
        Returns : [B, S]
        """
        features = self.features(state, ambient, duty, fan)
        here = torch.stack([state[:, 0], ambient, duty, fan], dim=-1)
        source = self.trust(here) * self.scaled_source(features) * self.source_scale
        return self.twin.step(state, ambient, duty, fan, source)

    def features(self, state: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """Return the network's inputs, [B, 4]: (T_hat, T_amb, duty, fan), T_hat the solution without r."""
        uncorrected = self.twin.step(state, ambient, duty, fan, torch.zeros_like(duty))
        return torch.stack([uncorrected[:, 0], ambient, duty, fan], dim=-1)

    def scaled_source(self, features: Tensor) -> Tensor:
        """Return the network's own output, of variance 1 in the training data, [B]."""
        scaled: Tensor = self.mlp((features - self.mean) / self.scale)
        return scaled.squeeze(-1)

    def trust(self, here: Tensor) -> Tensor:
        """1 in the box of the training data, 0 beyond the margin around it; here : [B, 4], returns [B]."""
        outside = torch.relu(self.low - here) + torch.relu(here - self.high)
        return torch.relu(1.0 - outside / self.margin).prod(dim=-1)


def train(
    runs: Sequence[RecordedRun],
    twin: BoxTwin,
    seed: int,
    settings: GuardedHamSettings,
    log: Path | None = None,
) -> tuple[GuardedHamNet, Progress]:
    """Fit the network on the training parts of `runs`, stopped by their validation parts.

    twin : fitted on the same training parts; log : folder for TensorBoard; None for none
    Errors : DataError for a test run
    """
    return train_on(split_all(runs), twin, seed, settings, log)


def train_on(
    parts: Split, twin: BoxTwin, seed: int, settings: GuardedHamSettings, log: Path | None = None
) -> tuple[GuardedHamNet, Progress]:
    """`train`, on runs that are divided already."""
    make_deterministic(seed)
    network = GuardedHamNet(TwinStep.of(twin), settings.hidden, settings.dropout)
    features, source, here = _steps(network, parts.train)
    mean, scale = scaler(features)
    network.mean.copy_(mean)
    network.scale.copy_(scale)
    network.source_scale.copy_(source.std())
    network.low.copy_(here.amin(dim=0))
    network.high.copy_(here.amax(dim=0))
    network.margin.copy_(torch.tensor(settings.margin))
    validation_features, validation_source, _ = _steps(network, parts.validate)
    fitted = Pairs(features, source / network.source_scale)
    validated = Pairs(validation_features, validation_source / network.source_scale)
    return network, fit(network, network.scaled_source, fitted, validated, settings, seed, log)


@torch.no_grad()
def _steps(network: GuardedHamNet, runs: Sequence[RecordedRun]) -> tuple[Tensor, Tensor, Tensor]:
    """Features [n, 4], the r that reaches the next measurement [n], and (T, T_amb, duty, fan) [n, 4]."""
    features, sources, here = [], [], []
    for stretch in stretches(runs):
        columns = [torch.from_numpy(column).float() for column in stretch]
        temp, ambient, duty, fan = columns
        states = network.twin.filter_states(*(column[None] for column in columns))[0]
        now = slice(SETTLING_ROWS, -1)
        inputs = ambient[now], duty[now], fan[now]
        rows = network.features(states[now], *inputs)
        features.append(rows)
        sources.append((temp[SETTLING_ROWS + 1 :] - rows[:, 0]) / network.twin.response(fan[now]))
        here.append(torch.stack([temp[now], *inputs], dim=-1))
    return torch.cat(features), torch.cat(sources), torch.cat(here)
