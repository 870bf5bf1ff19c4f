"""Every network that sees a window, a row each: weights and export read this table."""

from collections.abc import Mapping

from training.models.lstm import LstmNet
from training.models.window_network import WindowNet

NETWORKS: Mapping[str, type[WindowNet]] = {
    "lstm": LstmNet,
}
