"""The networks: what they see and repeat, when training stops, what is refused, and both kinds of hybrid."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from training_runs import BOX, box_run

from edge.core.errors import DataError
from edge.twin.geometry import Geometry
from edge.twin.model import BoxTwin
from edge.twin.warm_start import PastColumns, state_now
from training.data.pairs import split_all, stretches, transitions, windows
from training.models import ham, pbm
from training.models.fit_network import EarlyStopping, Pairs, fit
from training.models.ham import GuardedHamNet, HamNet
from training.models.predictors import WindowPredictor
from training.models.rollout import errors, free_run
from training.models.twin_step import TwinStep
from training.models.weights import NETWORKS, load_network, save_network
from training.models.window_network import WINDOW, LstmNet, WindowNet, WindowSettings, train
from training.models.window_network import train as train_window
from training.rl import checkpoint
from training.rl.saved_policy import load_q_network

TINY_LSTM = WindowSettings(epochs=2, hidden=4)
TINY_HAM = ham.HamSettings(epochs=2, hidden=4)
TINY_GUARDED = ham.GuardedHamSettings(epochs=2, hidden=4)


@pytest.mark.parametrize(
    ("losses", "stops_at"),
    [
        ([1.0, 0.9, 0.8, 0.7], None),
        ([1.0, 1.0, 1.0, 1.0], 4),  # three epochs without progress after the first
        ([1.0, 0.96, 0.92, 0.88], None),  # slow, but 0.1 below the last that counted in time: 0.88
        ([1.0, 0.9, 0.9, 0.9], 4),  # exactly min_delta lower is no progress: 0.9 < 1.0 - 0.1 is false
        ([1.0, 2.0, 3.0, 0.95], 4),
        ([1.0, 2.0, 3.0, 0.8], None),
        ([1.0, math.nan, math.nan, math.nan], 4),
        ([math.nan, math.nan, math.nan], 3),
        ([math.inf, 1.0, math.inf, 0.5], None),
    ],
)
def test_training_stops_after_epochs_without_progress(losses: list[float], stops_at: int | None) -> None:
    stopping = EarlyStopping(min_delta=0.1, tolerance=3)
    over = [epoch for epoch, loss in enumerate(losses, start=1) if stopping.is_over(loss)]
    assert (over[0] if over else None) == stops_at


def test_the_settings_are_the_paper_s() -> None:
    paper = {"epochs": 5000, "learning_rate": 1e-3, "batch_size": 40, "hidden": 64, "dropout": 0.2,
             "min_delta": 5e-4, "tolerance": 10}  # fmt: skip
    usual = WindowSettings(), ham.HamSettings()
    assert {key: getattr(usual[0], key) for key in paper} == paper
    assert {key: getattr(usual[1], key) for key in paper} == paper | {"epochs": 1000, "batch_size": 64}


def test_the_lstm_has_the_paper_s_layers_in_its_order() -> None:
    network = LstmNet(torch.zeros(3), torch.ones(3), 0.0, 1.0)
    called: list[str] = []
    for name, layer in network.named_children():
        layer.register_forward_hook(lambda *_, name=name: called.append(name))
    assert network(torch.zeros(5, 10, 3)).shape == (5,)
    assert called == [
        "lstm_1", "linear_1", "dropout", "lstm_2", "linear_2", "dropout", "lstm_3", "linear_3"
    ]  # fmt: skip


def test_the_hybrid_s_network_has_the_paper_s_layers() -> None:
    layers = [type(layer).__name__ for layer in ham.source_network(64, 0.2)]
    assert layers == ["Linear", "ReLU", "Dropout", "Linear", "ReLU", "Dropout", "Linear"]


def train_lstm(seed: int) -> nn.Module:
    return train_window(LstmNet, [box_run(1)], seed, TINY_LSTM)[0]


def train_ham(seed: int) -> nn.Module:
    return ham.train([box_run(1)], seed, TINY_HAM)[0]


def train_guarded(seed: int) -> nn.Module:
    return ham.train_guarded([box_run(1)], BOX, seed, TINY_GUARDED)[0]


@pytest.mark.parametrize("train", [train_ham, train_guarded])
def test_the_same_seed_gives_the_same_weights_and_another_seed_others(train) -> None:
    first, again, other = (train(seed).state_dict() for seed in (3, 3, 4))
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not all(torch.equal(first[name], other[name]) for name in first)


@pytest.mark.parametrize("train", [
    lambda runs: train_window(LstmNet, runs, 0, TINY_LSTM),
    lambda runs: ham.train(runs, 0, TINY_HAM),
    lambda runs: ham.train_guarded(runs, BOX, 0, TINY_GUARDED),
    lambda runs: pbm.train(runs, pbm.FITTED),
])  # fmt: skip
def test_nothing_is_fitted_on_a_test_run(train) -> None:
    with pytest.raises(DataError, match="test"):
        train([box_run(1), box_run(2, role="test")])


def test_windows_hold_what_acts_until_the_predicted_row() -> None:
    columns = box_run(1).columns
    inputs, following = windows([box_run(1)], 10)
    assert inputs.shape == (80, 10, 3)  # 90 rows
    assert inputs[7, -1].tolist() == [columns[key][16] for key in ("temp_air_c", "heater_duty", "fan_on")]
    assert following[7] == columns["temp_air_c"][17]


def test_no_window_spans_a_missing_reading_or_two_runs() -> None:
    run = box_run(1)
    temp = run.columns["temp_air_c"].copy()
    temp[30] = np.nan
    gappy = replace(run, columns={**run.columns, "temp_air_c": temp})
    inputs, following = windows([gappy, box_run(2)], 10)
    # 30 and 59 whole rows of the first run, 90 of the second; each gives its rows less 10
    assert len(following) == 20 + 49 + 80
    assert np.isfinite(inputs).all()


def test_training_parts_come_before_validation_parts() -> None:
    parts = split_all([box_run(1), box_run(2)])
    assert [len(part) for part in (*parts.train, *parts.validate)] == [72, 72, 18, 18]
    assert parts.validate[0].columns["temp_air_c"][0] == box_run(1).columns["temp_air_c"][72]


def test_the_weights_of_the_best_epoch_are_kept() -> None:
    # A step of 1 jumps over the optimum at 0.5 and back: the loss is least long before the last epoch.
    network = nn.Linear(1, 1, bias=False)
    nn.init.constant_(network.weight, 0.0)
    pairs = Pairs(torch.ones(4, 1), torch.full((4,), 0.5))
    settings = WindowSettings(epochs=6, learning_rate=1.0, min_delta=0.0, tolerance=6)
    losses: list[float] = []

    def predict(features: torch.Tensor) -> torch.Tensor:
        found = network(features).squeeze(-1)
        if not network.training:
            losses.append(float(nn.functional.mse_loss(found.detach(), pairs.target)))
        return found

    progress = fit(network, predict, pairs, pairs, settings, seed=0)
    assert progress.epochs == len(losses) == 6
    assert progress.best_epoch == 1 + losses.index(min(losses)) < 6
    assert float((network.weight.detach() - 0.5) ** 2) == pytest.approx(progress.validation_loss)
    assert not network.training


def test_a_training_that_gives_no_numbers_says_so() -> None:
    network = nn.Linear(1, 1)
    pairs = Pairs(torch.ones(4, 1), torch.full((4,), math.nan))
    with pytest.raises(DataError, match="no number in 10 epochs"):
        fit(network, lambda x: network(x).squeeze(-1), pairs, pairs, WindowSettings(), seed=0)


def test_runs_that_are_too_short_for_a_window_are_refused() -> None:
    with pytest.raises(DataError, match="too short"):
        train_window(LstmNet, [box_run(1, rows=20)], 0, TINY_LSTM)


def test_a_few_epochs_bring_the_lstm_near_the_box() -> None:
    # Temperatures spread by about 2 K: what does not learn misses by that much.
    settings = WindowSettings(epochs=40, hidden=16, learning_rate=1e-2)
    network, _ = train_window(LstmNet, [box_run(seed) for seed in range(4)], 0, settings)
    run = box_run(9)
    found = errors(free_run(WindowPredictor(network), run), run)
    assert found.mae_k < 0.5 * float(np.std(run.columns["temp_air_c"]))


def test_the_lstm_s_scaler_is_of_the_training_part_alone() -> None:
    network = train_lstm(0)
    temps = windows(split_all([box_run(1)]).train, 10)[0].reshape(-1, 3)
    assert network.mean.tolist() == pytest.approx(temps.mean(axis=0).tolist(), rel=1e-6)
    assert network.scale.tolist() == pytest.approx(temps.std(axis=0).tolist(), rel=1e-6)


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


def tensors(*values: object) -> list[torch.Tensor]:
    return [torch.as_tensor(value, dtype=torch.float32) for value in values]


def bare_ham() -> HamNet:
    """A HAM whose network gives r = 0 K/s."""
    network = HamNet(Geometry(), 60.0, torch.zeros(4), torch.ones(4), 0.0, 0.0)
    return network.eval()


@pytest.fixture(scope="module")
def guarded() -> GuardedHamNet:
    network, _ = ham.train_guarded([box_run(1), box_run(2)], BOX, 0, TINY_GUARDED)
    return network


def test_without_a_source_it_is_the_paper_s_physics() -> None:
    temp, ambient, duty, fan = [25.0, 30.0, 28.0], [22.0, 21.0, 22.5], [1.0, 0.0, 0.45], [0.0, 1.0, 1.0]
    expected = BoxTwin().step(temp, ambient, duty, fan)
    found = bare_ham()(*tensors(temp, ambient, duty, fan))
    assert found.tolist() == pytest.approx(expected.tolist(), abs=1e-4)


def test_the_bare_physics_heats_33_kelvin_a_minute() -> None:
    # 100 W over 1.2 * 0.15 * 1005 = 180.9 J/K for 60 s
    [after] = bare_ham()(*tensors([20.0], [20.0], [1.0], [0.0])).tolist()
    assert after - 20.0 == pytest.approx(6000.0 / 180.9, abs=1e-3)


@pytest.mark.parametrize("fan", [0.0, 0.5, 1.0])
def test_the_source_derived_from_two_measurements_reproduces_the_second(fan: float) -> None:
    network = bare_ham()
    columns = tensors([22.0, 28.0, 36.0], [22.0, 21.5, 22.0], [0.0, 0.5, 1.0], [fan] * 3)
    following = torch.tensor([22.1, 27.0, 36.4])
    source = network.source_between(*columns, following)
    for i, r in enumerate(source.tolist()):
        network.source_mean.fill_(r)  # the network's own share is 0 here: this is its r
        [after] = network(*(column[i : i + 1] for column in columns)).tolist()
        assert after == pytest.approx(float(following[i]), abs=2e-5)


def test_a_source_is_integrated_and_not_just_added() -> None:
    # With the fan on the air that leaves takes the source along: phi = (1 - a) V / F = 7.94 s, not 60 s.
    network = bare_ham()
    inputs = tensors([25.0], [22.0], [0.0], [1.0])
    [before] = network(*inputs).tolist()
    network.source_mean.fill_(0.1)
    [after] = network(*inputs).tolist()
    rate = 68.0 / 3600.0 / 0.15
    assert after - before == pytest.approx(0.1 * (1 - np.exp(-60 * rate)) / rate, abs=1e-5)


def test_the_scaler_of_the_training_data_travels_in_the_network() -> None:
    run = box_run(1)
    network, _ = ham.train([run], 0, TINY_HAM)
    last = 72  # rows of the training part: four fifths of 90
    data = transitions([run])
    features = network.features(*tensors(data.temp, data.ambient, data.duty, data.fan))[: last - 1]
    buffers = dict(network.named_buffers())
    assert torch.allclose(buffers["mean"], features.mean(dim=0), rtol=1e-5)
    assert buffers["source_scale"] > 0.0
    assert {"mean", "scale", "source_mean", "source_scale"} <= network.state_dict().keys()


def test_a_column_that_never_changes_leaves_finite_predictions() -> None:
    run = box_run(1)
    steady = replace(run, columns={**run.columns, "temp_ambient_c": np.full(len(run), 22.0)})
    network, _ = ham.train([steady], 0, TINY_HAM)
    assert torch.isfinite(network(*tensors([25.0], [22.3], [0.5], [0.0]))).all()


def test_the_twin_in_torch_is_the_twin_of_the_edge() -> None:
    step = TwinStep.of(BOX)
    state = np.array([[25.0, 24.0, 60.0], [31.0, 28.0, 0.0]])
    inputs = [22.0, 21.0], [0.5, 0.0], [0.0, 1.0], [0.0, 1e-3]
    expected = BOX.advance(state, *(np.array(values) for values in inputs))
    assert step.step(*tensors(state, *inputs)).numpy() == pytest.approx(expected, abs=1e-4)


def test_the_hidden_states_are_found_as_on_the_edge() -> None:
    columns = box_run(3).columns
    names = ("temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")
    window = [columns[name][30:40] for name in names]
    expected = state_now(BOX, PastColumns(*window))
    found = TwinStep.of(BOX).start(*(column[None] for column in tensors(*window)))[0]
    assert found.tolist() == pytest.approx(expected.tolist(), abs=1e-2)


def test_a_sensor_with_a_bias_moves_the_room_as_on_the_edge() -> None:
    biased = replace(BOX, effects={**BOX.effects, "sensor_bias": {"bias": 0.5}})
    names = ("temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")
    window = [box_run(3).columns[name][30:40] for name in names]
    found = TwinStep.of(biased).start(*(column[None] for column in tensors(*window)))[0]
    assert found.tolist() == pytest.approx(state_now(biased, PastColumns(*window)).tolist(), abs=1e-2)
    following = TwinStep.of(biased).step(found[None], *tensors([22.0], [0.5], [0.0], [0.0]))
    as_measured = TwinStep.of(BOX).step(found[None], *tensors([22.5], [0.5], [0.0], [0.0]))
    assert following.tolist() == as_measured.tolist()


def test_weights_kept_before_the_shift_have_none(guarded: GuardedHamNet, tmp_path: Path) -> None:
    save_network(guarded, tmp_path / "network.pt", {})
    content = torch.load(tmp_path / "network.pt", weights_only=True)
    del content["weights"]["twin.room_shift"]
    torch.save(content, tmp_path / "network.pt")
    loaded, _ = load_network(tmp_path / "network.pt")
    assert float(loaded.get_buffer("twin.room_shift")) == 0.0
    del content["weights"]["twin.noise"]
    torch.save(content, tmp_path / "network.pt")
    with pytest.raises(RuntimeError, match=r"twin\.noise"):
        load_network(tmp_path / "network.pt")


def test_the_guarded_source_reproduces_the_next_measurement() -> None:
    step = TwinStep.of(BoxTwin(effects={"wall_loss": {"UA": 4.0}, "extra_capacity": {"kC": 20.0}}))
    for temp, ambient, duty, fan in stretches([box_run(1)]):
        states = tensors(temp[:-1, None])[0]
        inputs = tensors(ambient[:-1], duty[:-1], fan[:-1])
        uncorrected = step.step(states, *inputs, torch.zeros(len(states)))[:, 0]
        source = (tensors(temp[1:])[0] - uncorrected) / step.response(inputs[2])
        corrected = step.step(states, *inputs, source)[:, 0]
        assert corrected.tolist() == pytest.approx(temp[1:].tolist(), abs=1e-4)


@pytest.mark.parametrize("column", range(4))
@pytest.mark.parametrize("side", ["low", "high"])
def test_trust_fades_over_the_margin_of_the_box(guarded: GuardedHamNet, column: int, side: str) -> None:
    edge, margin = getattr(guarded, side), guarded.margin[column]
    outwards = margin if side == "high" else -margin
    found = []
    for share in (-1e-3, 0.0, 0.5, 1.0, 100.0):
        here = (guarded.low + guarded.high) / 2
        here[column] = edge[column] + share * outwards
        found.append(float(guarded.trust(here[None])[0]))
    assert found == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0], abs=1e-4)


def test_outside_the_box_it_is_the_fitted_twin(guarded: GuardedHamNet) -> None:
    state = np.array([[45.0, 40.0, 30.0]])  # hotter than any training row
    expected = BOX.advance(state, 22.0, 0.3, 0.0)
    found = guarded(*tensors(state, [22.0], [0.3], [0.0]))
    assert found.detach().numpy() == pytest.approx(expected, abs=1e-4)


def test_inside_the_box_the_network_corrects(guarded: GuardedHamNet) -> None:
    state = np.array([[24.0, 23.0, 20.0]])
    inputs = tensors(state, [22.0], [0.3], [0.0])
    with torch.no_grad():
        guarded.mlp[-1].bias += 1.0
        more = guarded(*inputs)
        guarded.mlp[-1].bias -= 1.0
        less = guarded(*inputs)
    assert float(more[0, 0]) > float(less[0, 0])


def test_a_reading_that_is_no_number_gives_none() -> None:
    assert torch.isnan(bare_ham()(*tensors([float("nan")], [22.0], [0.3], [0.0]))).all()
