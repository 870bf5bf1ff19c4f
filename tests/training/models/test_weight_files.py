"""Files of weights come from others: loading one must never run what a pickle in it names."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from edge.core.errors import DataError
from training.models.weights import load_network
from training.rl import checkpoint
from training.rl.weights import load_q_network


class TouchesAFile:
    """Unpickling an instance creates `path`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self._path,)


@pytest.mark.parametrize(
    "load",
    [load_network, load_q_network, lambda path: checkpoint.restore(None, path)],
    ids=["network", "Q-network", "checkpoint"],
)
def test_a_file_of_weights_that_would_run_code_is_refused_before_it_does(load, tmp_path):
    path, trace = tmp_path / "weights.pt", tmp_path / "code was run"
    torch.save({"format": 1, "kind": "LstmNet", "0.weight": TouchesAFile(trace)}, path)
    with pytest.raises(DataError, match=r"weights\.pt"):
        load(path)
    assert not trace.exists()
