"""Hybrids by the corrective source term approach (CoSTA): HAM of the paper, and ours over a fitted twin.

The paper's stands over the bare physics-based model:

    dT/dt = H / (rho V c) - F (T - T_amb) / V + r(T_hat, T_amb, H, F)    (eq:method-hybrid-model)

The equation is solved without r for T_hat, the network gives r from it, and the equation is solved again with
r, constant over the step. H, F and T_amb are constant over a step too, so both solutions are exact:

    T+ = a T + phi (H / (rho V c) + F T_amb / V + r),   a = exp(-F dt / V),  phi = (1 - a) V / F

which gives r its training target from two measured temperatures: phi is 60 s with the fan off and 8 s with
the fan on, never small. But a is 5e-4 with the fan on: T_hat then hardly depends on T any more, and neither
does what the paper's HAM predicts.

Ours, the guarded one, makes no correction where there were no data. Its base is `edge.twin` with effects
whose parameters are fitted on the training runs; its state is the air and what the board doesn't measure
(heat of the heater's element, temperature of the walls). Over one step, exactly, with the inputs constant:

    x+ = A x + B (u_h, T_amb, r)

It is solved with r = 0 for T_hat, the network gives r, and it is solved again. r fades to 0 within a margin
around the box of the training data: outside it the model is the fitted twin and nothing else.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from edge.formats.run_file import RecordedRun
from edge.twin.geometry import Geometry
from edge.twin.model import BoxTwin
from training.data.datasets import Split
from training.data.pairs import Transitions, scaler, split_all, stretches, transitions
from training.models.fit_network import Pairs, Progress, fit, make_deterministic
from training.models.twin_step import TwinStep

HIDDEN = 64
DROPOUT = 0.2
STEP_S = 60.0


@dataclass(frozen=True, slots=True)
class HamSettings:
    """The paper's values. `min_delta` is of the MSE of the scaled r, see `EarlyStopping`."""

    epochs: int = 1000
    learning_rate: float = 1e-3
    batch_size: int = 64
    hidden: int = HIDDEN
    dropout: float = DROPOUT
    min_delta: float = 5e-4
    tolerance: int = 10


class HamNet(nn.Module):
    """One step of the corrected equation; in and out in plain units, geometry and scaler inside.

    Buffers `mean` and `scale` [4] belong to (T_hat [°C], T_amb [°C], H [W], F [m³/s]), `source_mean` and
    `source_scale` to r [K/s].
    """

    mean: Tensor
    scale: Tensor
    source_mean: Tensor
    source_scale: Tensor
    step_s: Tensor
    volume_m3: Tensor
    heater_max_w: Tensor
    fan_max_m3_s: Tensor
    air_j_k: Tensor

    def __init__(
        self,
        geometry: Geometry,
        step_s: float,
        mean: Tensor,
        scale: Tensor,
        source_mean: float,
        source_scale: float,
        hidden: int = HIDDEN,
        dropout: float = DROPOUT,
    ) -> None:
        super().__init__()
        air_j_k = geometry.air_density_kg_m3 * geometry.volume_m3 * geometry.air_heat_capacity_j_kg_k
        constants = {
            "mean": mean,
            "scale": scale,
            "source_mean": source_mean,
            "source_scale": source_scale,
            "step_s": step_s,
            "volume_m3": geometry.volume_m3,
            "heater_max_w": geometry.heater_max_w,
            "fan_max_m3_s": geometry.fan_max_m3_s,
            "air_j_k": air_j_k,
        }
        # Buffers, not attributes: they are saved with the weights and go into the graph.
        for name, value in constants.items():
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32))
        self.mlp = source_network(hidden, dropout)

    def forward(self, temp: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """Air temperature one step later, all [B].

        temp, ambient : air and room temperature [°C]; duty : 0..1; fan : 0 or 1 (or the share of the step)
        Returns : [°C]
        """
        kept, weight, drive = self._solution(ambient, duty, fan)
        features = self.features(temp, ambient, duty, fan)
        source = self.scaled_source(features) * self.source_scale + self.source_mean
        return kept * temp + weight * (drive + source)

    def features(self, temp: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """Return the network's inputs, [B, 4]: (T_hat, T_amb, H, F), T_hat the solution without r."""
        kept, weight, drive = self._solution(ambient, duty, fan)
        uncorrected = kept * temp + weight * drive
        return torch.stack([uncorrected, ambient, duty * self.heater_max_w, fan * self.fan_max_m3_s], dim=-1)

    def scaled_source(self, features: Tensor) -> Tensor:
        """Return the network's own output, of mean 0 and variance 1 in the training data, [B]."""
        scaled: Tensor = self.mlp((features - self.mean) / self.scale)
        return scaled.squeeze(-1)

    def source_between(
        self, temp: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor, following: Tensor
    ) -> Tensor:
        """Return the r that takes `temp` to `following` in one step [K/s], all [B]."""
        kept, weight, drive = self._solution(ambient, duty, fan)
        return (following - kept * temp) / weight - drive

    def _solution(self, ambient: Tensor, duty: Tensor, fan: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return a, phi [s] and the drive of the air without r [K/s]."""
        rate = fan * self.fan_max_m3_s / self.volume_m3
        kept = torch.exp(-rate * self.step_s)
        moving = rate > 0.0
        weight = torch.where(moving, (1.0 - kept) / torch.where(moving, rate, 1.0), self.step_s)
        return kept, weight, duty * self.heater_max_w / self.air_j_k + rate * ambient


def source_network(hidden: int, dropout: float) -> nn.Sequential:
    """Return the paper's layers (tab:method-model-parameters-hybrid) from four features to r."""
    return nn.Sequential(
        nn.Linear(4, hidden),
        nn.ReLU(),
        nn.Dropout(dropout),
        nn.Linear(hidden, hidden),
        nn.ReLU(),
        nn.Dropout(dropout),
        nn.Linear(hidden, 1),
    )


def train(
    runs: Sequence[RecordedRun], seed: int, settings: HamSettings, log: Path | None = None
) -> tuple[HamNet, Progress]:
    """Fit the network on the training parts of `runs`, stopped by their validation parts.

    log : folder for TensorBoard; None for none
    Errors : DataError for a test run
    """
    make_deterministic(seed)
    parts = split_all(runs)
    fitted, validated = transitions(parts.train), transitions(parts.validate)
    network = HamNet(
        Geometry(), STEP_S, torch.zeros(4), torch.ones(4), 0.0, 1.0, settings.hidden, settings.dropout
    )
    _scale(network, fitted)
    pairs = _pairs(network, fitted), _pairs(network, validated)
    return network, fit(network, network.scaled_source, *pairs, settings, seed, log)


def _scale(network: HamNet, data: Transitions) -> None:
    """Fill the scaler's buffers by what the training data say."""
    inputs = (_tensor(values) for values in (data.temp, data.ambient, data.duty, data.fan))
    mean, scale = scaler(network.features(*inputs))
    network.mean.copy_(mean)
    network.scale.copy_(scale)
    source_mean, source_scale = scaler(_source(network, data)[:, None])
    network.source_mean.copy_(source_mean[0])
    network.source_scale.copy_(source_scale[0])


def _pairs(network: HamNet, data: Transitions) -> Pairs:
    inputs = (_tensor(values) for values in (data.temp, data.ambient, data.duty, data.fan))
    scaled = (_source(network, data) - network.source_mean) / network.source_scale
    return Pairs(network.features(*inputs), scaled)


def _source(network: HamNet, data: Transitions) -> Tensor:
    columns = (data.temp, data.ambient, data.duty, data.fan, data.following)
    return network.source_between(*(_tensor(values) for values in columns))


def _tensor(values: object) -> Tensor:
    return torch.as_tensor(values, dtype=torch.float32)


FEATURES = 4
SETTLING_ROWS = 10  # of a stretch: its hidden states begin at a guess, nothing is learnt from these


@dataclass(frozen=True, slots=True)
class GuardedHamSettings(HamSettings):
    """The paper's values for its HAM, and the guard."""

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


def train_guarded(
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
    return train_guarded_on(split_all(runs), twin, seed, settings, log)


def train_guarded_on(
    parts: Split, twin: BoxTwin, seed: int, settings: GuardedHamSettings, log: Path | None = None
) -> tuple[GuardedHamNet, Progress]:
    """`train_guarded`, on runs that are divided already."""
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
