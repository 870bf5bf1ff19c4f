"""A linear twin as matrices in torch: one exact step, and its state from ten measured rows."""

import torch
from torch import Tensor, nn


class TwinStep(nn.Module):
    """x+ = A x + B (u_h, T_amb, r), A and B by the fan; x is [air temperature [°C], unmeasured states].

    Buffers: `transition` [2, S, S] and `drive` [2, S, 3] with the fan off and on; `rest_excess` and
    `rest_ambient` [S], the state at rest per kelvin over the room and per kelvin of the room; `spread` [S], how
    far (sd) the state may be from rest; `drift` [S], what it moves in a step that the model doesn't know (sd);
    `noise`, sd of a measured temperature [K].
    """

    def __init__(
        self,
        transition: Tensor,
        drive: Tensor,
        rest_excess: Tensor,
        rest_ambient: Tensor,
        spread: Tensor,
        drift: Tensor,
        noise: float,
    ) -> None:
        super().__init__()
        buffers = {
            "transition": transition,
            "drive": drive,
            "rest_excess": rest_excess,
            "rest_ambient": rest_ambient,
            "spread": spread,
            "drift": drift,
            "noise": torch.tensor(noise),
        }
        for name, values in buffers.items():
            self.register_buffer(name, values.float())

    def step(self, state: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor, source: Tensor) -> Tensor:
        """The state one step later; state [B, S]; ambient [°C], duty, fan 0..1, source [K/s] : [B]."""
        inputs = torch.stack([duty, ambient, source], dim=-1)
        off = state @ self.transition[0].T + inputs @ self.drive[0].T
        on = state @ self.transition[1].T + inputs @ self.drive[1].T
        return off + fan.unsqueeze(-1) * (on - off)

    def start(self, temp: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """The state at the last row, by a Kalman filter that begins at rest.

        temp, ambient [°C], duty, fan : [B, rows]; the last row's duty and fan are not read
        Returns : [B, S]
        """
        excess = (temp[:, 0] - ambient[:, 0]).unsqueeze(-1)
        state = self.rest_excess * excess + self.rest_ambient * ambient[:, :1]
        covariance = torch.diag(self.spread**2).expand(len(temp), -1, -1)
        none = torch.zeros_like(temp[:, 0])
        for k in range(temp.shape[1] - 1):
            matrix = self._transition(fan[:, k])
            state = self.step(state, ambient[:, k], duty[:, k], fan[:, k], none)
            covariance = matrix @ covariance @ matrix.transpose(1, 2) + torch.diag(self.drift**2)
            gain = covariance[:, :, 0] / (covariance[:, 0, :1] + self.noise**2)
            state = state + gain * (temp[:, k + 1] - state[:, 0]).unsqueeze(-1)
            covariance = covariance - gain.unsqueeze(-1) * covariance[:, :1, :]
        return state

    def _transition(self, fan: Tensor) -> Tensor:
        share = fan.reshape(-1, 1, 1)
        return self.transition[0] + share * (self.transition[1] - self.transition[0])
