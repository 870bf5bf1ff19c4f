"""Every network of the table: what it must see, what it gives, and the same weights for the same seed."""

from typing import Any

import pytest
import torch
from torch import Tensor
from training_runs import box_run

from training.models.networks import NETWORKS
from training.models.window_network import WINDOW, WindowNet, WindowSettings, train

torch.set_num_threads(1)


def made(name: str, **settings: Any) -> WindowNet:
    torch.manual_seed(4)
    return NETWORKS[name](torch.zeros(3), torch.ones(3), 0.0, 1.0, hidden=8, **settings).eval()


@pytest.mark.parametrize("name", NETWORKS)
def test_a_prediction_depends_on_every_row_and_column_of_the_window(name: str) -> None:
    # Many windows: a rectifier that is off in one of them hides rows there.
    window = torch.randn(64, WINDOW, 3, generator=torch.Generator().manual_seed(1)).requires_grad_()
    found = made(name)(window)
    assert found.shape == (64,)
    (slope,) = torch.autograd.grad(found[:63].sum(), window)
    assert (slope[:63] != 0.0).any(dim=0).all()
    assert (slope[63] == 0.0).all()  # another window's prediction does not read it


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("increment", [False, True])
def test_the_target_is_brought_back_to_kelvin(name: str, increment: bool) -> None:
    network = made(name, predicts_increment=increment)
    network.target_mean.fill_(0.25)
    network.target_scale.fill_(0.0)
    window = torch.full((1, WINDOW, 3), 20.0)
    assert network(window).tolist() == [20.25 if increment else 0.25]


@pytest.mark.parametrize("name", NETWORKS)
def test_the_same_seed_gives_the_same_weights(name: str) -> None:
    def weights(seed: int) -> dict[str, Tensor]:
        return dict(
            train(NETWORKS[name], [box_run(1)], seed, WindowSettings(epochs=1, hidden=4))[0].state_dict()
        )

    first, again, other = weights(3), weights(3), weights(4)
    assert all(torch.equal(first[key], again[key]) for key in first)
    assert not all(torch.equal(first[key], other[key]) for key in first)
