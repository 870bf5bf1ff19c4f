"""A fast two-node box: air and cover. The plant of the MPC benchmark and of the first default ARX model."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TwoNodeBox:
    """Heat balance of air and cover; the fan exchanges air with the room.

    C_air dT/dt = 100 W u_h - G_ac (T - T_c) - G_fan u_f (T - T_room)
    C_cover dT_c/dt = G_ac (T - T_c) - G_cr (T_c - T_room)
    """

    air_j_k: float = 500.0  # 0.15 m³ of air (181 J/K) and what follows it within a step
    cover_j_k: float = 3200.0  # 2.7 kg of polycarbonate at 1200 J/(kg K)
    air_cover_w_k: float = 13.6  # 1.7 m² at 8 W/(m² K)
    cover_room_w_k: float = 13.6
    fan_w_k: float = 15.5  # 68 m³/h at an effectiveness of 0.68
    heater_w: float = 100.0
    substeps: int = 6  # per control step: 10 s at 60 s

    def step(self, state: Floats, heater: Floats, fan: Floats, room: float, step_s: float) -> Floats:
        """State [..., 2] (air, cover) [°C] after `step_s` with inputs held (RK4)."""
        dt = step_s / self.substeps
        for _ in range(self.substeps):
            k1 = self._slope(state, heater, fan, room)
            k2 = self._slope(state + 0.5 * dt * k1, heater, fan, room)
            k3 = self._slope(state + 0.5 * dt * k2, heater, fan, room)
            k4 = self._slope(state + dt * k3, heater, fan, room)
            state = state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return state

    def _slope(self, state: Floats, heater: Floats, fan: Floats, room: float) -> Floats:
        air, cover = state[..., 0], state[..., 1]
        to_cover = self.air_cover_w_k * (air - cover)
        to_room = self.fan_w_k * fan * (air - room)
        air_slope = (self.heater_w * heater - to_cover - to_room) / self.air_j_k
        cover_slope = (to_cover - self.cover_room_w_k * (cover - room)) / self.cover_j_k
        return np.stack(np.broadcast_arrays(air_slope, cover_slope), axis=-1)
