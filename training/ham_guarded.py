"""Our HAM, beyond the paper: CoSTA over a fitted twin, and no correction where there were no data.

The base is a linear twin with states (air, what the board doesn't measure: heat of the heater's element, walls)
whose parameters are fitted on the training runs. Over one step, exactly, with the inputs constant:

    x+ = A x + B (u_h, T_amb, r)

As in CoSTA it is solved with r = 0 for T_hat, the network gives r from it, and it is solved again. r fades to
0 within a margin around the box of the training data: outside it the model is the fitted twin and nothing else.
"""

import torch
from torch import Tensor, nn

from training.twin_step import TwinStep

HIDDEN = 64
DROPOUT = 0.2


class GuardedHamNet(nn.Module):
    """One step of state [B, S] (column 0 the air, °C); geometry, scaler and box inside.

    Buffers of 4 belong to (T [°C], T_amb [°C], duty, fan): `low`, `high` of the training data and `margin`,
    over which the correction fades. `mean`, `scale` [4] belong to (T_hat, T_amb, duty, fan).
    """

    def __init__(
        self,
        twin: TwinStep,
        mean: Tensor,
        scale: Tensor,
        source_scale: float,
        low: Tensor,
        high: Tensor,
        margin: Tensor,
        hidden: int = HIDDEN,
        dropout: float = DROPOUT,
    ) -> None:
        super().__init__()
        self.twin = twin
        buffers = {"mean": mean, "scale": scale, "low": low, "high": high, "margin": margin}
        for name, values in {**buffers, "source_scale": torch.tensor(source_scale)}.items():
            self.register_buffer(name, values.float())
        self.mlp = nn.Sequential(
            nn.Linear(4, hidden),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(hidden, 1),
        )

    def start(self, temp: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """The state at the last row of a window of measurements, all [B, rows]; the last inputs aren't read.

        Returns : [B, S]
        """
        return self.twin.start(temp, ambient, duty, fan)

    def forward(self, state: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """The state one step later.

        state : [B, S]; ambient [°C], duty 0..1, fan 0 or 1 (or the share of the step) : [B]
        Returns : [B, S]
        """
        uncorrected = self.twin.step(state, ambient, duty, fan, torch.zeros_like(duty))
        here = torch.stack([state[:, 0], ambient, duty, fan], dim=-1)
        source = self.trust(here) * self.source(uncorrected[:, 0], ambient, duty, fan)
        return self.twin.step(state, ambient, duty, fan, source)

    def source(self, uncorrected: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """The corrective source term r [K/s] before the guard, all [B]; uncorrected : T_hat [°C]."""
        features = (torch.stack([uncorrected, ambient, duty, fan], dim=-1) - self.mean) / self.scale
        return self.mlp(features).squeeze(-1) * self.source_scale

    def trust(self, here: Tensor) -> Tensor:
        """1 inside the box of the training data, 0 beyond the margin around it; here : [B, 4]. Returns : [B]."""
        outside = torch.relu(self.low - here) + torch.relu(here - self.high)
        return torch.relu(1.0 - outside / self.margin).prod(dim=-1)
