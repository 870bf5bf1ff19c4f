"""A diagonal state-space model, S4D (Gu et al. 2022, arXiv 2206.11893), small.

Chosen over a Transformer because its layer has the shape of the problem: a box is a sum of first-order lags,
and this layer is a learnt bank of lags. Attention over 10 rows would have to learn that from 4000 windows.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import conv1d, gelu, pad

from training.models.window_network import COLUMNS, WINDOW, WindowNet

LAYERS = 2
MODES = 4  # complex pairs per channel
DT_MIN, DT_MAX = (
    0.01,
    1.0,
)  # the slowest lag decays in 2 / dt rows: 2 to 200; S4D's 0.001..0.1 is for long ones


class SsmNet(WindowNet):
    """A linear layer in, residual state-space layers, and a linear layer on the last row."""

    def add_layers(self, hidden: int, dropout: float) -> None:
        """As `WindowNet.add_layers`."""
        self.encoder = nn.Linear(len(COLUMNS), hidden)
        self.layers = nn.Sequential(*(SsmLayer(hidden, dropout) for _ in range(LAYERS)))
        self.head = nn.Linear(hidden, 1)

    def read(self, scaled: Tensor) -> Tensor:
        """As `WindowNet.read`."""
        found: Tensor = self.head(self.layers(self.encoder(scaled))[:, -1])
        return found


class SsmLayer(nn.Module):
    """Each channel through its own modes, then a gated mix of the channels; [B, rows, hidden] in and out.

    With poles a = -exp(`log_decay`) + i `frequency` and steps dt = exp(`log_dt`) the response k rows after a
    unit input is 2 Re(sum over modes of c (exp(a dt) - 1) / a exp(a dt k)): a held input, solved exactly.
    """

    def __init__(self, hidden: int, dropout: float) -> None:
        super().__init__()
        spread = torch.rand(hidden, 1) * math.log(DT_MAX / DT_MIN)
        self.log_dt = nn.Parameter(math.log(DT_MIN) + spread)
        # S4D-Lin: every mode decays alike, their frequencies are evenly spaced.
        self.log_decay = nn.Parameter(torch.full((hidden, MODES), math.log(0.5)))
        self.frequency = nn.Parameter(math.pi * torch.arange(MODES).repeat(hidden, 1).float())
        self.output = nn.Parameter(math.sqrt(0.5) * torch.randn(2, hidden, MODES))  # c, real and imaginary
        self.through = nn.Parameter(torch.randn(hidden))
        self.mix = nn.Sequential(nn.Linear(hidden, 2 * hidden), nn.GLU(dim=-1))
        self.norm = nn.LayerNorm(hidden)
        self.dropout = nn.Dropout(dropout)

    def forward(self, rows: Tensor) -> Tensor:
        """Return the layer's rows with its input added, each from itself and earlier ones."""
        by_channel = rows.transpose(1, 2)
        # conv1d correlates: the response is turned round, its first row meets the present input.
        kernel = self.response().flip(-1).unsqueeze(1)
        seen = conv1d(pad(by_channel, (WINDOW - 1, 0)), kernel, groups=len(kernel))
        active = gelu(seen + self.through.unsqueeze(-1) * by_channel).transpose(1, 2)
        found: Tensor = self.norm(rows + self.dropout(self.mix(self.dropout(active))))
        return found

    def response(self) -> Tensor:
        """Return what is left of a unit input after 0..9 rows, [hidden, 10], in real numbers.

        ONNX has no complex numbers, so real and imaginary parts are written out.
        """
        dt = self.log_dt.exp()
        decay, turn = self.log_decay.exp(), self.frequency
        size, angle = torch.exp(-decay * dt), turn * dt
        # (exp(a dt) - 1) / a, a = -decay + i turn
        over, up = size * angle.cos() - 1.0, size * angle.sin()
        norm = decay**2 + turn**2
        held = (turn * up - decay * over) / norm, (-decay * up - turn * over) / norm
        real = self.output[0] * held[0] - self.output[1] * held[1]
        imaginary = self.output[0] * held[1] + self.output[1] * held[0]
        k = torch.arange(WINDOW, dtype=dt.dtype)
        lasting = torch.exp(-(decay * dt).unsqueeze(-1) * k)
        angles = angle.unsqueeze(-1) * k
        waves = real.unsqueeze(-1) * angles.cos() - imaginary.unsqueeze(-1) * angles.sin()
        return 2.0 * (lasting * waves).sum(dim=1)
