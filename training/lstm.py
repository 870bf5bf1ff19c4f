"""The LSTM of the paper (tab:method-model-parameters-lstm), one step ahead from a window of 10."""

from torch import Tensor, nn

WINDOW = 10
HIDDEN = 64
DROPOUT = 0.2


class LstmNet(nn.Module):
    """Three times LSTM and Linear, dropout between; in and out in plain units, the scaler inside.

    Buffers `mean` and `scale` [3] hold what the training data say of T, u_h and u_f.
    """

    def __init__(self, mean: Tensor, scale: Tensor, hidden: int = HIDDEN, dropout: float = DROPOUT) -> None:
        super().__init__()
        self.register_buffer("mean", mean.float())
        self.register_buffer("scale", scale.float())
        self.lstm_1 = nn.LSTM(3, hidden, batch_first=True)
        self.linear_1 = nn.Linear(hidden, hidden)
        self.lstm_2 = nn.LSTM(hidden, hidden, batch_first=True)
        self.linear_2 = nn.Linear(hidden, hidden)
        self.lstm_3 = nn.LSTM(hidden, hidden, batch_first=True)
        self.linear_3 = nn.Linear(hidden, 1)
        self.dropout = nn.Dropout(dropout)

    def forward(self, window: Tensor) -> Tensor:
        """Air temperature one step after the last row.

        window : [B, 10, 3]; row k holds the air temperature [°C] at k and the heater duty and fan state
            that act from k to k + 1
        Returns : [B] [°C]
        """
        hidden, _ = self.lstm_1((window - self.mean) / self.scale)
        hidden, _ = self.lstm_2(self.dropout(self.linear_1(hidden)))
        hidden, _ = self.lstm_3(self.dropout(self.linear_2(hidden)))
        scaled = self.linear_3(hidden[:, -1]).squeeze(-1)
        return scaled * self.scale[0] + self.mean[0]
