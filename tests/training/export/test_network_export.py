"""Exported graphs beside the torch modules they come from; the weights are drawn, not trained."""

import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx import ModelProto
from torch import Tensor, nn

from edge.core.errors import DataError
from edge.core.predictor import Floats
from edge.formats.run_file import RecordedRun
from edge.models import contract
from edge.models.onnx_predictor import OnnxPredictor, read_lstm
from edge.twin.geometry import Geometry
from edge.twin.model import BoxTwin
from training.data.datasets import EXTRAPOLATION_MAX_C
from training.export.ham_graph import divide, scan_steps
from training.export.network_export import ExportFacts, export, main
from training.export.onnx_graph import Graph, real
from training.export.onnx_step import ham_start, single_step
from training.models.ham import GuardedHamNet, HamNet
from training.models.registry import NETWORK_FILE
from training.models.study import RESULT_FILE
from training.models.twin_step import TwinStep
from training.models.weights import NETWORKS, save_network
from training.models.window_network import COLUMNS, WINDOW, LstmNet, WindowNet

STEP_K, ROLLOUT_K = 1e-5, 1e-3  # what the exported may differ by: over one step, over a whole run
BOX = {
    "temp_air_c": (20.0, 40.0),
    "temp_ambient_c": (18.0, 24.0),
    "heater_duty": (0.0, 1.0),
    "fan_on": (0.0, 1.0),
}
FACTS = ExportFacts("greenhouse-train lstm", 3, "d" * 64, BOX, {"mae_k": 0.5})


class FlatNet(WindowNet):
    """A network that this repository does not have: one layer over the window."""

    def add_layers(self, hidden: int, dropout: float) -> None:
        self.layer = nn.Linear(WINDOW * len(COLUMNS), 1)

    def read(self, scaled: Tensor) -> Tensor:
        found: Tensor = self.layer(scaled.flatten(1))
        return found


torch.set_num_threads(1)  # the tests run beside each other


def run_file(rows: int = 222) -> RecordedRun:
    """Smooth temperatures, random inputs."""
    generator = np.random.default_rng(5)
    time_s = 60.0 * np.arange(rows)
    return RecordedRun(
        {
            "time_s": time_s,
            "temp_air_c": 28.0 + 5.0 * np.sin(time_s / 3000.0) + generator.normal(0.0, 0.1, rows),
            "temp_ambient_c": 21.0 + np.sin(time_s / 5000.0),
            "heater_duty": generator.integers(0, 21, rows) / 20.0,
            "fan_on": generator.integers(0, 2, rows).astype(float),
        }
    )


def past(rows: int = WINDOW) -> dict[str, Floats]:
    columns = run_file().columns
    names = {
        "temp_air": "temp_air_c",
        "temp_ambient": "temp_ambient_c",
        "heater_duty": "heater_duty",
        "fan_on": "fan_on",
    }
    return {name: columns[key][:rows] for name, key in names.items()}


def inputs(batch: int, horizon: int) -> tuple[Floats, dict[str, Floats]]:
    """Random controls [batch, horizon, 2], room temperatures and offsets."""
    generator = np.random.default_rng(1000 * batch + horizon)
    duty, fan = generator.random((batch, horizon)), generator.integers(0, 2, (batch, horizon))
    ahead = {
        "temp_ambient": generator.uniform(18.0, 24.0, horizon),
        "offset": generator.normal(0.0, 0.05, horizon),
    }
    return np.stack([duty, fan], axis=-1), ahead


def window_net(network_type: type[WindowNet], predicts_increment: bool) -> WindowNet:
    torch.manual_seed(1)
    target = (0.02, 0.3) if predicts_increment else (28.0, 4.0)
    scale = torch.tensor([28.0, 0.5, 0.4]), torch.tensor([4.0, 0.3, 0.5])
    network = network_type(*scale, *target, predicts_increment=predicts_increment).eval()
    if network_type is LstmNet:  # as it is drawn, it hardly looks at its window
        for parameter in network.parameters():
            parameter.data *= 3.0
    return network


def ham() -> HamNet:
    torch.manual_seed(2)
    mean, scale = torch.tensor([40.0, 21.0, 50.0, 0.009]), torch.tensor([10.0, 2.0, 30.0, 0.009])
    return HamNet(Geometry(), 60.0, mean, scale, -0.25, 0.05).eval()


def guarded() -> GuardedHamNet:
    torch.manual_seed(3)
    effects = {
        "wall_mass": {"C_w": 18000.0, "G_in": 6.0, "G_out": 11.0},
        "extra_capacity": {"kC": 6.0},
        "sensor_bias": {"bias": 0.4},
    }
    twin = BoxTwin(effects=effects)
    network = GuardedHamNet(TwinStep.of(twin))
    for name, values in {
        "mean": (28.0, 21.0, 0.5, 0.5),
        "scale": (4.0, 2.0, 0.3, 0.5),
        "low": (24.0, 18.0, 0.0, 0.0),
        "high": (32.0, 24.0, 1.0, 1.0),
        "margin": (0.5, 0.5, 0.05, 0.5),
        "source_scale": (0.01,),
    }.items():
        buffer = network.get_buffer(name)
        buffer.copy_(torch.tensor(values).reshape(buffer.shape))
    return network.eval()


@torch.no_grad()
def window_reference(network: WindowNet, controls: Floats, offset: Floats) -> Floats:
    """The window moved by hand, one sequence after the other."""
    names = ("temp_air", "heater_duty", "fan_on")
    sequences = []
    for sequence in controls:
        window = torch.tensor(np.stack([past()[name] for name in names], axis=-1), dtype=torch.float32)
        temps = []
        for k, (duty, fan) in enumerate(sequence):
            window[-1, 1:] = torch.tensor([duty, fan], dtype=torch.float32)
            temps.append(float(network(window[None])) + offset[k])
            window = torch.cat(
                [window[1:], torch.tensor([[temps[-1], torch.nan, torch.nan]], dtype=torch.float32)]
            )
        sequences.append(temps)
    return np.array(sequences)


@torch.no_grad()
def ham_reference(
    network: HamNet | GuardedHamNet, state: Tensor, controls: Floats, ahead: dict[str, Floats]
) -> Floats:
    """Steps of `network` from a state [B] or [B, S]."""
    temps = []
    for k in range(controls.shape[1]):
        now = torch.tensor(controls[:, k], dtype=torch.float32)
        room = torch.full((len(controls),), float(ahead["temp_ambient"][k]))
        state = network(state, room, now[:, 0], now[:, 1])
        air = state if state.ndim == 1 else state[:, 0]
        air += ahead["offset"][k]
        temps.append(air.double().numpy().copy())
    return np.stack(temps, axis=1)


EVERY = [(LstmNet, True), (FlatNet, True), *((network, False) for network in NETWORKS.values())]


@pytest.fixture(scope="module", params=EVERY, ids=lambda param: f"{param[0].__name__}-{param[1]}")
def window_pair(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[WindowNet, OnnxPredictor]:
    """A network and its file, read by the rig's own loader and proved by the golden vectors in it."""
    network = window_net(*request.param)
    path = tmp_path_factory.mktemp("network") / "lstm.onnx"
    export(network, FACTS, run_file(), path)
    return network, read_lstm(path, 60.0)


@pytest.fixture(scope="module")
def ham_pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[HamNet, OnnxPredictor]:
    network = ham()
    facts = ExportFacts("greenhouse-train ham", 0, "d" * 64, BOX, {}, BoxTwin().sha256)
    return network, export(network, facts, run_file(), tmp_path_factory.mktemp("ham") / "ham.onnx")


def test_a_network_in_one_graph_is_its_module_at_every_horizon(
    window_pair: tuple[WindowNet, OnnxPredictor],
) -> None:
    network, model = window_pair
    controls, ahead = inputs(2, 60)
    expected = window_reference(network, controls, ahead["offset"])
    assert np.ptp(expected) > 1.0  # the weights do something
    for horizon in range(1, 61):
        found = model.rollout(past(), controls[:, :horizon], ahead)
        np.testing.assert_allclose(found, expected[:, :horizon], rtol=0, atol=STEP_K * (1 + horizon))


def test_a_network_keeps_to_its_module_over_a_whole_run(window_pair: tuple[WindowNet, OnnxPredictor]) -> None:
    network, model = window_pair
    controls, ahead = inputs(1, 212)
    expected = window_reference(network, controls, ahead["offset"])
    np.testing.assert_allclose(model.rollout(past(), controls, ahead), expected, rtol=0, atol=ROLLOUT_K)


def test_single_steps_agree_from_every_row_of_a_run(window_pair: tuple[WindowNet, OnnxPredictor]) -> None:
    network, model = window_pair
    columns = past(222)
    table = np.stack([columns[name] for name in ("temp_air", "heater_duty", "fan_on")], axis=-1)
    windows = np.stack([table[row : row + WINDOW] for row in range(len(table) - WINDOW)])
    with torch.no_grad():
        expected = network(torch.tensor(windows, dtype=torch.float32)).numpy()
    found = []
    for row, window in enumerate(windows):
        history = {name: values[row : row + WINDOW] for name, values in columns.items()}
        found.append(model.rollout(history, window[None, -1:, 1:], {})[0, 0])
    np.testing.assert_allclose(found, expected, rtol=0, atol=STEP_K)


@pytest.mark.parametrize("batch", [1, 42, 130])
def test_a_batch_is_its_rows_one_by_one(
    batch: int, window_pair: tuple[WindowNet, OnnxPredictor], ham_pair: tuple[HamNet, OnnxPredictor]
) -> None:
    controls, ahead = inputs(batch, 5)
    for _, model in (window_pair, ham_pair):
        alone = np.concatenate([model.rollout(past(), one[None], ahead) for one in controls])
        np.testing.assert_allclose(model.rollout(past(), controls, ahead), alone, rtol=0, atol=STEP_K)


@pytest.mark.parametrize(("horizon", "limit_k"), [(1, STEP_K), (20, ROLLOUT_K), (212, ROLLOUT_K)])
def test_the_hybrid_in_one_graph_is_its_module(
    horizon: int, limit_k: float, ham_pair: tuple[HamNet, OnnxPredictor]
) -> None:
    network, model = ham_pair
    controls, ahead = inputs(3, horizon)
    start = torch.full((3,), float(past()["temp_air"][-1]))
    expected = ham_reference(network, start, controls, ahead)
    np.testing.assert_allclose(model.rollout(past(), controls, ahead), expected, rtol=0, atol=limit_k)


@pytest.fixture(scope="module")
def guarded_step() -> tuple[GuardedHamNet, ModelProto]:
    network = guarded()
    return network, single_step(network)


@torch.no_grad()
def test_a_single_step_is_the_module_for_any_batch(guarded_step: tuple[GuardedHamNet, ModelProto]) -> None:
    network, step = guarded_step
    session = onnxruntime.InferenceSession(step.SerializeToString())
    for batch in (1, 5):
        controls, _ = inputs(batch, 1)
        duty, fan = controls[:, 0].T.astype(np.float32)
        state = np.random.default_rng(batch).uniform(20.0, 40.0, (batch, 2)).astype(np.float32)
        feed = {"state": state, "ambient": np.full(batch, 21.0, dtype=np.float32), "duty": duty, "fan": fan}
        expected = network(*(torch.tensor(values) for values in feed.values()))
        np.testing.assert_allclose(session.run(None, feed)[0], expected, rtol=0, atol=STEP_K)


def test_the_guarded_hybrid_carries_its_hidden_states(guarded_step: tuple[GuardedHamNet, ModelProto]) -> None:
    network, step = guarded_step
    rows = 3
    graph = scan_steps(ham_start(network, rows), step, rows)
    session = onnxruntime.InferenceSession(graph.SerializeToString())
    window = np.stack([past(rows)[name] for name in contract.FEATURES["ham_guarded"]], axis=-1)
    start = network.start(*torch.tensor(window.T[:, None], dtype=torch.float32))
    assert start.shape == (1, 2)  # air and wall
    for horizon, limit_k in ((1, STEP_K), (212, ROLLOUT_K)):
        controls, ahead = inputs(4, horizon)
        feed = {"window": window, "controls": controls, **ahead}
        feed["ambient"] = feed.pop("temp_ambient")
        (found,) = session.run(None, {name: values.astype(np.float32) for name, values in feed.items()})
        expected = ham_reference(network, start.repeat(4, 1), controls, ahead)
        np.testing.assert_allclose(found, expected, rtol=0, atol=limit_k)


def test_the_file_says_where_it_comes_from(window_pair: tuple[WindowNet, OnnxPredictor]) -> None:
    network, model = window_pair
    facts = model.contract.facts
    assert facts["scaler"]["scale"] == pytest.approx(network.scale.tolist())
    assert (facts["command"], facts["seed"], facts["data_sha256"]) == (FACTS.command, 3, "d" * 64)
    assert facts["metrics"] == {"mae_k": 0.5}
    assert (
        facts["software"]["torch"] == torch.__version__.split("+")[0]
        or facts["software"]["torch"] == torch.__version__
    )
    assert {"onnx", "numpy", "python"} <= facts["software"].keys()
    assert model.validity == {key: BOX[key] for key in contract.keys(network.kind)}
    assert max(golden.temps.shape[1] for golden in model.contract.golden) == 222 - WINDOW  # the whole run


def test_the_same_network_gives_the_same_file(tmp_path: Path) -> None:
    network = window_net(LstmNet, False)
    paths = (tmp_path / name for name in ("a.onnx", "b.onnx"))
    versions = {export(network, FACTS, run_file(), path).version for path in paths}
    assert len(versions) == 1


@pytest.mark.parametrize(
    ("rows", "hole", "message"), [(222, 7, "without missing readings"), (60, None, "too few")]
)
def test_golden_vectors_need_a_whole_run(rows: int, hole: int | None, message: str, tmp_path: Path) -> None:
    run = run_file(rows)
    if hole is not None:
        run.columns["temp_air_c"][hole] = np.nan
    with pytest.raises(DataError, match=message):
        export(window_net(LstmNet, False), FACTS, run, tmp_path / "lstm.onnx")
    assert not (tmp_path / "lstm.onnx").exists()


def test_a_kept_training_is_exported_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    facts = {
        "regime": "extrapolation",
        "command": "greenhouse-train lstm",
        "seed": 2,
        "data_sha256": "e" * 64,
    }
    save_network(window_net(LstmNet, True), tmp_path / NETWORK_FILE, facts)
    record = {"progress": {"epochs": 7}, "scenarios": {"4": {"free_run": {"mae_k": 0.5}}}}
    (tmp_path / RESULT_FILE).write_text(json.dumps(record))
    path = tmp_path / "lstm.onnx"
    assert main([str(tmp_path), str(path)]) == 0
    assert "golden vectors proved" in capsys.readouterr().out
    model = read_lstm(path, 60.0)
    assert model.contract.facts["metrics"] == record
    assert model.contract.facts["seed"] == 2
    assert model.validity["temp_air_c"][1] <= EXTRAPOLATION_MAX_C  # the runs of that regime stay below


def test_a_folder_without_a_training_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path), str(tmp_path / "lstm.onnx")]) == 2
    assert f"{tmp_path / NETWORK_FILE}: " in capsys.readouterr().err


def step_graph() -> ModelProto:
    """next = state * exp(-fan) + [duty, number of rows]."""
    graph = Graph()
    kept = graph.op("Exp", graph.op("Neg", "fan"))
    rows = graph.op("Cast", graph.op("Shape", "duty"), to=onnx.TensorProto.FLOAT)
    column = graph.integers(1)
    count = graph.op("Expand", rows, graph.op("Shape", graph.op("Squeeze", "state", column)))
    added = graph.op("Add", "duty", count)
    moved = graph.op("Mul", "state", graph.op("Unsqueeze", kept, column))
    graph.give("next", graph.op("Add", moved, graph.op("Unsqueeze", added, column)))
    inputs = [real("state", ["B", 1]), *(real(name, ["B"]) for name in ("ambient", "duty", "fan"))]
    return graph.model("step", inputs, [real("next", ["B", 1])])


def run(model: ModelProto, feed: dict[str, Floats]) -> list[Floats]:
    session = onnxruntime.InferenceSession(model.SerializeToString())
    values: list[Floats] = session.run(None, {name: one.astype(np.float32) for name, one in feed.items()})
    return values


def kinds(model: ModelProto) -> set[str]:
    return {node.op_type for node in model.graph.node}


def test_what_does_not_depend_on_the_state_is_computed_before() -> None:
    parts = divide(step_graph(), "state")
    assert "Exp" in kinds(parts.before)
    assert "Exp" not in kinds(parts.after)
    assert "Mul" in kinds(parts.after)


def test_inputs_that_the_step_does_not_read_are_not_carried_through_the_loop() -> None:
    assert "ambient" not in {value.name for value in divide(step_graph(), "state").values}


def test_both_parts_together_are_the_step() -> None:
    parts = divide(step_graph(), "state")
    inputs = {"ambient": np.zeros(3), "duty": np.array([0.1, 0.2, 0.3]), "fan": np.array([0.0, 1.0, 2.0])}
    state = np.array([[20.0], [30.0], [40.0]])
    whole = run(step_graph(), {"state": state, **inputs})[0]
    np.testing.assert_allclose(whole[:, 0], [23.1, 30.0 / np.e + 3.2, 40.0 / np.e**2 + 3.3], rtol=1e-6)
    known = dict(zip((value.name for value in parts.values), run(parts.before, inputs), strict=True))
    assert np.array_equal(run(parts.after, {"state": state, **known})[0], whole)
