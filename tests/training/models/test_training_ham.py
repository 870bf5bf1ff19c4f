"""The corrective source term: its algebra, its scaler, its guard."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from training_runs import BOX, box_run

from edge.twin.geometry import Geometry
from edge.twin.model import BoxTwin
from edge.twin.warm_start import PastColumns, state_now
from training.data.pairs import stretches, transitions
from training.models import ham
from training.models.ham import GuardedHamNet, HamNet
from training.models.twin_step import TwinStep
from training.models.weights import load_network, save_network

QUICK = ham.HamSettings(epochs=2)
GUARDED_QUICK = ham.GuardedHamSettings(epochs=2)


def tensors(*values: object) -> list[torch.Tensor]:
    return [torch.as_tensor(value, dtype=torch.float32) for value in values]


def bare_ham() -> HamNet:
    """A HAM whose network gives r = 0 K/s."""
    network = HamNet(Geometry(), 60.0, torch.zeros(4), torch.ones(4), 0.0, 0.0)
    return network.eval()


@pytest.fixture(scope="module")
def guarded() -> GuardedHamNet:
    network, _ = ham.train_guarded([box_run(1), box_run(2)], BOX, 0, GUARDED_QUICK)
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
    network, _ = ham.train([run], 0, QUICK)
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
    network, _ = ham.train([steady], 0, QUICK)
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
