"""HAM of the paper: the corrective source term approach (CoSTA) over the bare physics-based model.

    dT/dt = H / (rho V c) - F (T - T_amb) / V + r(T_hat, T_amb, H, F)    (eq:method-hybrid-model)

The equation is solved without r for T_hat, the network gives r from it, and the equation is solved again with
r, constant over the step. H, F and T_amb are constant over a step too, so both solutions are exact:

    T+ = a T + phi (H / (rho V c) + F T_amb / V + r),   a = exp(-F dt / V),  phi = (1 - a) V / F
"""

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from edge.twin.geometry import Geometry

HIDDEN = 64
DROPOUT = 0.2


class HamNet(nn.Module):
    """One step of the corrected equation; in and out in plain units, geometry and scaler inside.

    Buffers `mean` and `scale` [4] belong to (T_hat [°C], T_amb [°C], H [W], F [m³/s]), `source_mean` and
    `source_scale` to r [K/s].
    """

    def __init__(
        self,
        geometry: "Geometry",
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
        for name, value in constants.items():
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32))
        self.mlp = nn.Sequential(
            nn.Linear(4, hidden),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(hidden, 1),
        )

    def forward(self, temp: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """Air temperature one step later, all [B].

        temp, ambient : air and room temperature [°C]; duty : 0..1; fan : 0 or 1 (or the share of the step)
        Returns : [°C]
        """
        heat, flow = duty * self.heater_max_w, fan * self.fan_max_m3_s
        rate = flow / self.volume_m3
        kept = torch.exp(-rate * self.step_s)
        moving = rate > 0.0
        weight = torch.where(moving, (1.0 - kept) / torch.where(moving, rate, 1.0), self.step_s)
        drive = heat / self.air_j_k + rate * ambient
        uncorrected = kept * temp + weight * drive
        source = self.source(uncorrected, ambient, heat, flow)
        return kept * temp + weight * (drive + source)

    def source(self, uncorrected: Tensor, ambient: Tensor, heat: Tensor, flow: Tensor) -> Tensor:
        """The corrective source term r [K/s], all [B].

        uncorrected : T_hat, the uncorrected prediction [°C]; heat : [W]; flow : [m³/s]
        """
        features = (torch.stack([uncorrected, ambient, heat, flow], dim=-1) - self.mean) / self.scale
        return self.mlp(features).squeeze(-1) * self.source_scale + self.source_mean
