"""A temporal convolutional network: causal dilated convolutions in residual blocks (Bai et al. 2018).

The blocks are those of arXiv 1803.01271: two weight-normed convolutions, each with ReLU and dropout, and a
1 x 1 convolution beside them where the width changes.
"""

from torch import Tensor, nn
from torch.nn.functional import pad, relu
from torch.nn.utils.parametrizations import weight_norm

from training.models.window_network import COLUMNS, WindowNet

KERNEL = 2
DILATIONS = (1, 2, 4)  # the last row sees 1 + 2 (1 + 2 + 4) = 15 rows: the whole window of 10


class TcnNet(WindowNet):
    """One residual block per dilation, and a linear layer on the last row."""

    def add_layers(self, hidden: int, dropout: float) -> None:
        """As `WindowNet.add_layers`."""
        sizes = (len(COLUMNS), *(hidden for _ in DILATIONS))
        self.blocks = nn.Sequential(
            *(TcnBlock(size, hidden, step, dropout) for size, step in zip(sizes, DILATIONS, strict=False))
        )
        self.head = nn.Linear(hidden, 1)

    def read(self, scaled: Tensor) -> Tensor:
        """As `WindowNet.read`."""
        found: Tensor = self.head(self.blocks(scaled.transpose(1, 2))[:, :, -1])
        return found


class TcnBlock(nn.Module):
    """Two causal convolutions with what came in added, [B, width, rows] to [B, hidden, rows]."""

    def __init__(self, width: int, hidden: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.missing_rows = dilation * (KERNEL - 1)  # before the first: zeros, so no row sees a later one
        self.first = weight_norm(nn.Conv1d(width, hidden, KERNEL, dilation=dilation))
        self.second = weight_norm(nn.Conv1d(hidden, hidden, KERNEL, dilation=dilation))
        self.beside = nn.Identity() if width == hidden else nn.Conv1d(width, hidden, 1)
        self.dropout = nn.Dropout(dropout)

    def forward(self, rows: Tensor) -> Tensor:
        """Return the block's rows, each from itself and earlier ones."""
        found = rows
        for convolution in (self.first, self.second):
            found = self.dropout(relu(convolution(pad(found, (self.missing_rows, 0)))))
        return relu(found + self.beside(rows))
