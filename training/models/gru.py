"""The paper's stack with another cell: the gated recurrent unit (Cho et al. 2014, arXiv 1406.1078)."""

from torch import Tensor, nn

from training.models.window_network import COLUMNS, WindowNet


class GruNet(WindowNet):
    """Three times GRU and Linear, dropout between: three quarters of the LSTM's recurrent weights."""

    def add_layers(self, hidden: int, dropout: float) -> None:
        """As `WindowNet.add_layers`."""
        sizes = (len(COLUMNS), hidden, hidden)
        self.cells = nn.ModuleList(nn.GRU(size, hidden, batch_first=True) for size in sizes)
        self.between = nn.ModuleList(nn.Linear(hidden, hidden) for _ in sizes[1:])
        self.head = nn.Linear(hidden, 1)
        self.dropout = nn.Dropout(dropout)

    def read(self, scaled: Tensor) -> Tensor:
        """As `WindowNet.read`."""
        hidden, _ = self.cells[0](scaled)
        for linear, cell in zip(self.between, self.cells[1:], strict=True):
            hidden, _ = cell(self.dropout(linear(hidden)))
        found: Tensor = self.head(hidden[:, -1])
        return found
