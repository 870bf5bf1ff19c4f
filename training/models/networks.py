"""Every network that sees a window, a row each: training, weights, export and comparison read this table."""

from collections.abc import Mapping, Sequence

from edge.core.errors import DataError
from training.models.gru import GruNet
from training.models.lstm import LstmNet
from training.models.ssm import SsmNet
from training.models.tcn import TcnNet
from training.models.window_network import WindowNet

NETWORKS: Mapping[str, type[WindowNet]] = {
    "lstm": LstmNet,
    "gru": GruNet,
    "tcn": TcnNet,
    "ssm": SsmNet,
}


def check_names(names: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of the networks to work on, all for None. Errors: DataError for an unknown one"""
    found = tuple(names or NETWORKS)
    if unknown := [name for name in found if name not in NETWORKS]:
        raise DataError(f"--networks: {', '.join(unknown)}: known are {', '.join(NETWORKS)}")
    return found
