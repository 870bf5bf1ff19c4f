"""The LSTM of the paper (tab:method-model-parameters-lstm)."""

from torch import Tensor, nn

from training.models.window_network import COLUMNS, WindowNet


class LstmNet(WindowNet):
    """Three times LSTM and Linear, dropout between."""

    kind = "lstm"  # a rig before the other networks knows it by this name

    def add_layers(self, hidden: int, dropout: float) -> None:
        """As `WindowNet.add_layers`."""
        self.lstm_1 = nn.LSTM(len(COLUMNS), hidden, batch_first=True)
        self.linear_1 = nn.Linear(hidden, hidden)
        self.lstm_2 = nn.LSTM(hidden, hidden, batch_first=True)
        self.linear_2 = nn.Linear(hidden, hidden)
        self.lstm_3 = nn.LSTM(hidden, hidden, batch_first=True)
        self.linear_3 = nn.Linear(hidden, 1)
        self.dropout = nn.Dropout(dropout)

    def read(self, scaled: Tensor) -> Tensor:
        """As `WindowNet.read`."""
        hidden, _ = self.lstm_1(scaled)
        hidden, _ = self.lstm_2(self.dropout(self.linear_1(hidden)))
        hidden, _ = self.lstm_3(self.dropout(self.linear_2(hidden)))
        found: Tensor = self.linear_3(hidden[:, -1])
        return found
