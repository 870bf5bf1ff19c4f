"""A twin as matrices in torch: its exact step, and its state from a window of measurements."""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from edge.core.errors import DataError
from edge.twin.model import BoxTwin
from edge.twin.signals import Signals
from edge.twin.warm_start import at_rest, drift, spread


class TwinStep(nn.Module):
    """x+ = A x + B (u_h, T_room, r), A and B by the fan; x is (air temperature [°C], hidden states).

    T_room is the measured T_amb and `room_shift`: how the air's sensor would show the room.

    Buffers, all of them `edge.twin`'s (see `edge/twin/warm_start.py`): `transition` [2, S, S] and `drive`
    [2, S, 3] with the fan off and on; `rest_excess` and `rest_ambient` [S], the state at rest per kelvin over
    the room and per kelvin of the room; `room_shift` [K]; `spread` [S], how far (sd) the state may be from
    rest; `drift` [2, S], what unknown heat does over a step (sd); `noise`, sd of a measured temperature [K].
    """

    transition: Tensor
    drive: Tensor
    rest_excess: Tensor
    rest_ambient: Tensor
    room_shift: Tensor
    spread: Tensor
    drift: Tensor
    noise: Tensor

    def __init__(self, states: int) -> None:
        super().__init__()
        shapes = {
            "transition": (2, states, states),
            "drive": (2, states, 3),
            "rest_excess": (states,),
            "rest_ambient": (states,),
            "room_shift": (),
            "spread": (states,),
            "drift": (2, states),
            "noise": (),
        }
        for name, shape in shapes.items():
            self.register_buffer(name, torch.zeros(shape))

    @classmethod
    def of(cls, twin: BoxTwin) -> "TwinStep":
        """Return the same physics as `twin`; between fan off and on the matrices are interpolated.

        Errors : DataError for a twin whose inputs do not act as they are: late, bent, or more than these
        """
        if beyond := beyond_a_graph(twin):
            raise DataError(
                f"twin: {', '.join(beyond)}: acts on the inputs or bends the balance, which a "
                "network's graph does not hold; the twin by itself forecasts with it"
            )
        step = cls(len(twin.states))
        shift = float(twin.signals.room(np.zeros(())))
        values: dict[str, NDArray[np.float64] | float] = {
            "transition": twin.off_on.state,
            "drive": twin.off_on.drive,
            "rest_excess": at_rest(twin, 1.0, -shift),  # at_rest is linear in both temperatures
            "rest_ambient": at_rest(twin, 1.0, 1.0 - shift),
            "room_shift": shift,
            "spread": spread(twin),
            "drift": drift(twin),
            "noise": twin.noise.sensor_k,
        }
        for name, value in values.items():
            step.get_buffer(name).copy_(torch.as_tensor(value))
        return step

    def step(self, state: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor, source: Tensor) -> Tensor:
        """Return the state one step later; state [B, S]; ambient [°C], duty, fan 0..1, source [K/s] : [B]."""
        inputs = torch.stack([duty, ambient + self.room_shift, source], dim=-1)
        off = state @ self.transition[0].T + inputs @ self.drive[0].T
        on = state @ self.transition[1].T + inputs @ self.drive[1].T
        return off + fan.unsqueeze(-1) * (on - off)

    def response(self, fan: Tensor) -> Tensor:
        """Return the effect on the air of a source of 1 K/s over one step [s], [B]."""
        return self.drive[0, 0, 2] + fan * (self.drive[1, 0, 2] - self.drive[0, 0, 2])

    def start(self, temp: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """Return the state at the last row: a Kalman filter that begins at rest; the air as last measured.

        temp, ambient [°C], duty, fan : [B, rows], nothing missing; the last row's duty and fan are not read
        Returns : [B, S]
        """
        return self.filter_states(temp, ambient, duty, fan)[:, -1]

    def filter_states(self, temp: Tensor, ambient: Tensor, duty: Tensor, fan: Tensor) -> Tensor:
        """Return the filtered state at every row, [B, rows, S]."""
        room = ambient[:, :1] + self.room_shift
        state = self.rest_excess * (temp[:, :1] - room) + self.rest_ambient * room
        covariance = torch.diag(self.spread**2).expand(len(temp), -1, -1)
        none = torch.zeros_like(temp[:, 0])
        states = [state]
        for k in range(temp.shape[1] - 1):
            state = self.step(state, ambient[:, k], duty[:, k], fan[:, k], none)
            covariance = self._predict(covariance, fan[:, k])
            gain = covariance[:, :, 0] / (covariance[:, 0, :1] + self.noise**2)
            state = state + gain * (temp[:, k + 1] - state[:, 0]).unsqueeze(-1)
            covariance = covariance - gain.unsqueeze(-1) * covariance[:, :1, :]
            states.append(state)
        hidden = torch.stack(states, dim=1)[:, :, 1:]
        return torch.cat([temp.unsqueeze(-1), hidden], dim=-1)

    def _predict(self, covariance: Tensor, fan: Tensor) -> Tensor:
        share = fan.reshape(-1, 1, 1)
        matrix = self.transition[0] + share * (self.transition[1] - self.transition[0])
        moved = self.drift[0] + share[:, 0] * (self.drift[1] - self.drift[0])
        unknown = moved.unsqueeze(2) * moved.unsqueeze(1)
        return matrix @ covariance @ matrix.transpose(1, 2) + unknown


def beyond_a_graph(twin: BoxTwin) -> list[str]:
    """Return the effects of a twin that need more than one matrix per fan speed and a shifted room."""
    return [
        name
        for name, values in twin.effects.items()
        if not _is_held(BoxTwin(twin.geometry, {name: values}, twin.step_s).signals)
    ]


def _is_held(signals: Signals) -> bool:
    return replace(signals, ambient_error_k=0.0, sensor_bias_k=0.0).plain
