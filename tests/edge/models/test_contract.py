"""Contracts of models, and the box of the training data that they name."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import TensorProto
from onnx_files import TWIN, document_of, graph_of, write_onnx

from edge.core.errors import DataError
from edge.core.predictor import Floats
from edge.models.contract import parse_contract
from edge.models.onnx_predictor import read_ham, read_lstm
from edge.models.validity import box_of, outside_steps
from training.export.onnx_graph import Graph, real

VALID = document_of("lstm")
BOX = VALID["validity"]
ONE_STEP, TWO_STEPS = VALID["golden"][1], VALID["golden"][0]


def refusal(path: Path) -> str:
    with pytest.raises(DataError) as caught:
        read_lstm(path, 60.0)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text.removeprefix(f"{path}: ")


def golden_with(key: str, value: Any) -> list[Any]:
    return [TWO_STEPS | {key: value}]


@pytest.mark.parametrize("kind", ["lstm", "window"])
def test_a_file_that_keeps_its_contract_is_read(kind: str, tmp_path: Path) -> None:
    model = read_lstm(write_onnx(tmp_path / "lstm.onnx", kind), 60.0)
    assert (model.name, model.kind, model.step_s, model.rows_needed) == ("lstm", kind, 60.0, 3)
    assert model.validity["temp_air_c"] == (0.0, 40.0)
    assert model.contract.facts["software"] == {"torch": "2.13.0"}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"contract": 2}, "contract: 2 is not 1"),
        ({"kind": "arx"}, "kind: 'arx' is none of lstm, window, ham, ham_guarded"),
        ({"features": ["temp_air", "fan_on", "heater_duty"]}, "features: ('temp_air', 'fan_on', "),
        ({"features": ["temp_air", "heater_duty"]}, "features: ('temp_air', 'heater_duty') is not"),
        ({"units": VALID["units"] | {"temp_air": "K"}}, "units: "),
        ({"units": VALID["units"] | {"heater_duty": "%"}}, "units: "),
        ({"sample_s": 10.0}, "sample_s: made for steps of 10 s, the rig's are 60 s"),
        ({"sample_s": 0}, "sample_s: 0 is not above 0"),
        ({"window": 0}, "window: 0 is below the smallest allowed, 1"),
        ({"window": 121}, "window: 121 is above the largest allowed, 120"),
        ({"window": 4}, "golden[0].window: shape (3, 3), not (4, 3)"),
        ({"validity": {**BOX, "temp_air_c": [30.0, 20.0]}}, "validity.temp_air_c: 30, 20 are not a lowest"),
        ({"validity": {**BOX, "temp_air": [0, 1]}}, "validity: does not bound exactly temp_air_c"),
        ({"tolerance": {"step_k": 1e-4, "rollout_k": 2e-3}}, "tolerance.rollout_k: 0.002 is above"),
        ({"tolerance": {"step_k": 2e-4, "rollout_k": 1e-3}}, "tolerance.step_k: 0.0002 is above"),
        ({"golden": []}, "golden: must hold at least 1"),
        ({"golden": [ONE_STEP]}, "golden: no rollout of more than one step"),
        ({"golden": golden_with("temps", [])}, "golden[0].temps: not numbers in 2 dimensions"),
        ({"golden": golden_with("temps", [[], []])}, "golden[0].temps: not numbers in 2 dimensions"),
        ({"golden": golden_with("temps", [[20.5, 20.75], [20.5]])}, "golden[0].temps: not numbers in 2 dim"),
        ({"golden": golden_with("temps", [[20.5]])}, "golden[0].controls: shape (1, 2, 2), not (1, 1, 2)"),
    ],
)  # fmt: skip
def test_a_contract_that_does_not_fit_is_refused_with_its_key(
    changed: dict[str, Any], message: str, tmp_path: Path
) -> None:
    assert refusal(write_onnx(tmp_path / "lstm.onnx", changed=changed)).startswith(message)


@pytest.mark.parametrize("key", sorted(VALID))
def test_no_key_of_the_contract_may_be_missing(key: str) -> None:
    with pytest.raises(DataError, match=f"^{key}: "):
        parse_contract(json.dumps({name: value for name, value in VALID.items() if name != key}))


@pytest.mark.parametrize(
    ("which", "missed_k", "is_refused"),
    [(0, 0.9e-3, False), (0, 1.1e-3, True), (1, 0.9e-4, False), (1, 1.1e-4, True)],
)
def test_golden_vectors_hold_to_1e_3_over_a_rollout_and_1e_4_over_a_step(
    which: int, missed_k: float, is_refused: bool, tmp_path: Path
) -> None:
    goldens = copy.deepcopy(VALID["golden"])
    goldens[which]["temps"][0][-1] += missed_k
    path = write_onnx(tmp_path / "lstm.onnx", changed={"golden": goldens})
    if is_refused:
        assert refusal(path).startswith(f"golden[{which}].temps: missed by ")
    else:
        read_lstm(path, 60.0)


@pytest.mark.parametrize(
    ("share", "missed"),
    [(0.1001, "0.004 K"), (np.nan, "nan K"), (np.inf, "inf K")],  # 2 steps of 20 °C * 1e-4
)
def test_a_graph_with_another_weight_misses_the_golden_vectors(
    share: float, missed: str, tmp_path: Path
) -> None:
    graph = graph_of("ham")
    scalars = [item for item in graph.graph.initializer if item.data_type == TensorProto.FLOAT]
    assert len(scalars) == 1  # the tenth of the room temperature
    scalars[0].raw_data = np.float32(share).tobytes()
    with pytest.raises(DataError, match=rf"ham\.onnx: golden\[0\]\.temps: missed by {missed}, 0\.001 K is"):
        read_ham(write_onnx(tmp_path / "ham.onnx", "ham", graph=graph), TWIN)


def test_a_graph_that_can_not_run_is_refused(tmp_path: Path) -> None:
    graph = Graph()
    reshaped = graph.op("Reshape", "controls", graph.integers(7, 11))
    used = graph.op("Add", graph.op("ReduceSum", "window"), graph.op("ReduceSum", "offset"))
    graph.give("temps", graph.op("Add", reshaped, used))
    inputs = [real("window", [3, 3]), real("controls", ["B", "N", 2]), real("offset", ["N"])]
    model = graph.model("broken", inputs, [real("temps", ["B", "N"])])
    assert refusal(write_onnx(tmp_path / "lstm.onnx", graph=model)).startswith("golden[0]: cannot be run: ")


def test_inputs_and_outputs_have_to_be_those_of_the_contract(tmp_path: Path) -> None:
    path = tmp_path / "lstm.onnx"
    assert refusal(write_onnx(path, graph=graph_of("lstm", window_input="rows"))).startswith(
        "inputs: {'rows'"
    )
    assert refusal(write_onnx(path, graph=graph_of("lstm", output="temp"))).startswith(
        "outputs: ['temp'] are not ['temps']"
    )
    assert refusal(write_onnx(path, graph=graph_of("ham_guarded"))).startswith("inputs: ")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(share: float, tmp_path: Path) -> None:
    path = write_onnx(tmp_path / "lstm.onnx")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    refusal(path)


def test_what_is_no_onnx_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lstm.onnx"
    path.write_text("not a model")
    assert refusal(path).startswith("not an ONNX file that can be run: ")
    assert refusal(tmp_path / "none.onnx").startswith("cannot be read: ")
    assert refusal(tmp_path).startswith("cannot be read: ")


def test_an_onnx_file_without_a_contract_is_refused(tmp_path: Path) -> None:
    assert refusal(write_onnx(tmp_path / "lstm.onnx", text="{")).startswith("greenhouse_contract: not JSON")
    message = refusal(write_onnx(tmp_path / "lstm.onnx", text=""))
    assert message.startswith("greenhouse_contract: missing in the metadata")


def test_one_kind_of_model_is_not_read_as_another(tmp_path: Path) -> None:
    assert refusal(write_onnx(tmp_path / "ham.onnx", "ham")) == "kind: 'ham' is none of lstm, window"
    with pytest.raises(DataError, match=r"lstm\.onnx: kind: 'lstm' is none of ham, ham_guarded"):
        read_ham(write_onnx(tmp_path / "lstm.onnx"), TWIN)


# the box of the training data: what is inside, on its edge, and what rests on something outside


LIMITS = {
    "temp_air_c": (20.0, 30.0),
    "heater_duty": (0.0, 0.5),
    "fan_on": (0.0, 1.0),
    "temp_ambient_c": (18.0, 24.0),
}


def outside(temps: list[float], duty: float = 0.25, room: float = 20.0, now: float = 25.0) -> list[bool]:
    """Flags of one sequence of two steps; its inputs are the same at both."""
    controls = np.array([[[duty, 1.0]] * 2])
    ahead = {"temp_ambient": np.array([room, room, np.nan])}  # longer than the rollout
    past = {"temp_air": np.array([99.0, now])}
    flags: list[bool] = outside_steps(LIMITS, past, controls, ahead, np.array([temps]))[0].tolist()
    return flags


def test_inside_and_on_the_edge_nothing_is_flagged() -> None:
    assert outside([25.0, 25.0]) == [False, False]
    assert outside([20.0, 30.0], duty=0.5, room=24.0, now=30.0) == [False, False]
    assert outside([25.0, 25.0], duty=0.5 + 1e-9) == [False, False]  # rounding is no extrapolation


@pytest.mark.parametrize("value", [19.99, 30.01, np.nan, np.inf, -np.inf])
def test_a_temperature_outside_is_flagged_from_its_step_on(value: float) -> None:
    assert outside([25.0, value]) == [False, True]
    assert outside([value, 25.0]) == [True, True]  # the second step was predicted from the first
    assert outside([25.0, 25.0], now=value) == [True, True]


@pytest.mark.parametrize("duty", [-0.01, 0.51, np.nan])
def test_an_input_outside_is_flagged(duty: float) -> None:
    assert outside([25.0, 25.0], duty=duty) == [True, True]


@pytest.mark.parametrize("room", [17.99, 24.01, np.nan])
def test_a_room_outside_is_flagged(room: float) -> None:
    assert outside([25.0, 25.0], room=room) == [True, True]


def test_each_sequence_is_flagged_by_itself() -> None:
    controls = np.array([[[0.5, 0.0]], [[0.6, 0.0]], [[0.5, 1.0]]])
    flags = outside_steps(
        {"heater_duty": (0.0, 0.5)}, {"temp_air": np.array([0.0])}, controls, {}, np.zeros((3, 1))
    )
    assert flags.tolist() == [[False], [True], [False]]


def test_the_box_of_runs_spans_what_was_measured() -> None:
    def run(*temps: float) -> dict[str, Floats]:
        return {"temp_air_c": np.array(temps), "light": np.ones(len(temps))}

    assert box_of([run(21.0, np.nan, 25.0), run(19.5)], ["temp_air_c"]) == {"temp_air_c": (19.5, 25.0)}
