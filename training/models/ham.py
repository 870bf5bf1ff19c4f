"""HAM of the paper: the corrective source term approach (CoSTA) over the bare physics-based model.

    dT/dt = H / (rho V c) - F (T - T_amb) / V + r(T_hat, T_amb, H, F)    (eq:method-hybrid-model)

The equation is solved without r for T_hat, the network gives r from it, and the equation is solved again with
r, constant over the step. H, F and T_amb are constant over a step too, so both solutions are exact:

    T+ = a T + phi (H / (rho V c) + F T_amb / V + r),   a = exp(-F dt / V),  phi = (1 - a) V / F

which gives r its training target from two measured temperatures: phi is 60 s with the fan off and 8 s with
the fan on, never small. But a is 5e-4 with the fan on: T_hat then hardly depends on T any more, and neither
does what the paper's HAM predicts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from edge.formats.run_file import RecordedRun
from edge.twin.geometry import Geometry
from training.data.pairs import Transitions, scaler, split_all, transitions
from training.models.fit_network import Pairs, Progress, fit, make_deterministic

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
