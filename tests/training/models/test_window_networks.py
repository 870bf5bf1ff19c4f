"""Every network of the table: what it may see, what it must see, what it learns."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from training_runs import box_run

from edge.core.errors import DataError
from training.models.networks import NETWORKS, check_names
from training.models.predictors import WindowPredictor
from training.models.rollout import errors, free_run
from training.models.ssm import SsmLayer
from training.models.tcn import TcnBlock
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


@pytest.mark.parametrize("layer", [TcnBlock(3, 3, 2, 0.0), TcnBlock(3, 5, 4, 0.0)])
def test_no_row_of_a_convolution_sees_a_later_one(layer: nn.Module) -> None:
    check_causal(lambda rows: layer(rows.transpose(1, 2)).transpose(1, 2))


def test_no_row_of_a_state_space_layer_sees_a_later_one() -> None:
    check_causal(SsmLayer(3, 0.0))


def check_causal(layer: Any) -> None:
    rows = torch.randn(1, WINDOW, 3)
    changed = rows.clone()
    changed[:, 6:] += 1.0
    before, after = layer(rows), layer(changed)
    assert torch.equal(before[:, :6], after[:, :6])
    assert (before[:, 6:] != after[:, 6:]).any(dim=-1).all()


@torch.no_grad()
def test_a_state_space_layer_responds_as_its_modes_step_by_step() -> None:
    # The same in complex numbers, one row after the other: x+ = exp(a dt) x + (exp(a dt) - 1) / a u.
    torch.manual_seed(2)
    layer = SsmLayer(5, 0.0).double()
    dt = layer.log_dt.exp().numpy()
    poles = -layer.log_decay.exp().numpy() + 1j * layer.frequency.numpy()
    output = layer.output[0].numpy() + 1j * layer.output[1].numpy()
    state = (np.exp(poles * dt) - 1.0) / poles  # after one unit input
    expected = []
    for _ in range(WINDOW):
        expected.append(2.0 * (output * state).sum(axis=1).real)
        state = np.exp(poles * dt) * state
    np.testing.assert_allclose(layer.response(), np.stack(expected, axis=1), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("increment", [False, True])
def test_the_target_is_brought_back_to_kelvin(name: str, increment: bool) -> None:
    network = made(name, predicts_increment=increment)
    network.target_mean.fill_(0.25)
    network.target_scale.fill_(0.0)
    window = torch.full((1, WINDOW, 3), 20.0)
    assert network(window).tolist() == [20.25 if increment else 0.25]


@pytest.mark.parametrize("name", [name for name in NETWORKS if name != "lstm"])  # the LSTM has its own test
def test_a_few_epochs_bring_a_network_near_the_box(name: str) -> None:
    settings = WindowSettings(epochs=25, hidden=16, learning_rate=1e-2)
    network, _ = train(NETWORKS[name], [box_run(seed) for seed in range(4)], 0, settings)
    run = box_run(9)
    found = errors(free_run(WindowPredictor(network), run), run)
    assert found.mae_k < 0.5 * float(np.std(run.columns["temp_air_c"]))


@pytest.mark.parametrize("name", NETWORKS)
def test_the_same_seed_gives_the_same_weights(name: str) -> None:
    def weights(seed: int) -> dict[str, Tensor]:
        return dict(
            train(NETWORKS[name], [box_run(1)], seed, WindowSettings(epochs=1, hidden=4))[0].state_dict()
        )

    first, again, other = weights(3), weights(3), weights(4)
    assert all(torch.equal(first[key], again[key]) for key in first)
    assert not all(torch.equal(first[key], other[key]) for key in first)


def test_an_unknown_network_is_named() -> None:
    assert check_names(None) == tuple(NETWORKS)
    with pytest.raises(DataError, match=r"--networks: rnn: known are lstm, gru, tcn, ssm"):
        check_names(["gru", "rnn"])
