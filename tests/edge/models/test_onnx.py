"""edge/models, ONNX files: contracts, the box of the training data, forecasts by hand, and policies."""

import copy
import hashlib
import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contexts import context
from onnx import TensorProto
from onnx_files import TWIN, WINDOWS, document_of, graph_of, write_onnx
from policy_files import document, graph, policy_file, weights_of, write

from edge.core.errors import DataError
from edge.core.messages import Command
from edge.core.predictor import Floats
from edge.formats.run_file import read_run
from edge.models import policy_observation as observation
from edge.models.contract import parse_contract
from edge.models.onnx_policy import read_policy
from edge.models.onnx_predictor import BATCH, KINDS, OnnxPredictor, read_ham, read_lstm
from edge.models.policy_actions import ACTIONS
from edge.models.policy_observation import (
    AIR_ROWS,
    FEATURES,
    INPUT_ROWS,
    NAMES,
    Recent,
    by_name,
    observe,
    observe_tick,
    table_sha256,
)
from edge.models.validity import box_of, outside_steps
from training.data.datasets import RUNS
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


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> OnnxPredictor:
    return read_lstm(write_onnx(tmp_path_factory.mktemp("lstm") / "lstm.onnx"))


def history(*temps: float) -> dict[str, Floats]:
    """Return a history of some air temperatures; the newest row's inputs are not decided yet."""
    inputs = np.array([0.0] * (len(temps) - 1) + [np.nan])
    return {"temp_air": np.array(temps), "heater_duty": inputs, "fan_on": inputs}


def duties(*rows: list[float]) -> Floats:
    duty = np.array(rows)
    return np.stack([duty, np.zeros_like(duty)], axis=-1)


def test_a_rollout_starts_from_the_newest_row(model: OnnxPredictor) -> None:
    temps = model.rollout(history(10.0, 30.0, 22.0, 20.0), duties([0.5, 0.25, 0.0]), {})
    assert temps.dtype == np.float64
    np.testing.assert_allclose(temps, [[20.5, 20.75, 20.75]])


def test_the_offset_is_carried_on_from_step_to_step(model: OnnxPredictor) -> None:
    ahead = {"offset": np.array([0.1, -0.2, 9.0])}  # longer than the rollout
    temps = model.rollout(history(20.0, 20.0, 20.0), duties([0.0, 0.0]), ahead)
    np.testing.assert_allclose(temps, [[20.1, 19.9]], rtol=1e-6)


@pytest.mark.parametrize("batch", [1, BATCH["lstm"] - 1, BATCH["lstm"], BATCH["lstm"] + 1, 3 * BATCH["lstm"]])
def test_a_batch_is_its_rows_one_by_one(batch: int, model: OnnxPredictor) -> None:
    controls = np.random.default_rng(0).random((batch, 4, 2))
    expected = 20.0 + controls[:, :, 0].cumsum(axis=1)
    found = model.rollout(history(20.0, 20.0, 20.0), controls, {})
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize("shape", [(0, 4, 2), (3, 0, 2)])
def test_nothing_asked_is_nothing_answered(shape: tuple[int, int, int], model: OnnxPredictor) -> None:
    assert model.rollout(history(20.0, 20.0, 20.0), np.zeros(shape), {}).shape == shape[:2]


def test_a_short_history_is_refused(model: OnnxPredictor) -> None:
    with pytest.raises(DataError, match="history: 2 rows, the lstm model needs 3"):
        model.rollout(history(20.0, 20.0), duties([0.0]), {})


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("column", "row"), [("temp_air", -1), ("temp_air", -3), ("heater_duty", -2), ("fan_on", -3)]
)
def test_a_missing_reading_in_the_window_gives_nan(
    column: str, row: int, value: float, model: OnnxPredictor
) -> None:
    past = history(20.0, 20.0, 20.0, 20.0)
    past[column] = past[column].copy()
    past[column][row] = value
    assert np.isnan(model.rollout(past, duties([0.0, 0.0], [1.0, 1.0]), {})).all()


def test_a_missing_reading_before_the_window_does_not_matter(model: OnnxPredictor) -> None:
    assert model.rollout(history(np.nan, 20.0, 20.0, 20.0), duties([0.5]), {})[0, 0] == pytest.approx(20.5)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_unknown_input_gives_nan_from_its_step_on_in_its_sequence_alone(
    value: float, model: OnnxPredictor
) -> None:
    temps = model.rollout(history(20.0, 20.0, 20.0), duties([0.5, value, 0.5], [0.5, 0.5, 0.5]), {})
    np.testing.assert_allclose(temps, [[20.5, np.nan, np.nan], [20.5, 21.0, 21.5]])


def test_an_unknown_offset_gives_nan_from_its_step_on(model: OnnxPredictor) -> None:
    temps = model.rollout(history(20.0, 20.0, 20.0), duties([0.5, 0.5]), {"offset": np.array([0.0, np.nan])})
    np.testing.assert_allclose(temps, [[20.5, np.nan]])


def test_the_version_is_the_hash_of_the_file(tmp_path: Path) -> None:
    path = write_onnx(tmp_path / "lstm.onnx")
    assert read_lstm(path).version == hashlib.sha256(path.read_bytes()).hexdigest()[:12]


def test_onnxruntime_is_imported_only_to_read_a_file() -> None:
    program = "import sys, edge.models.onnx_predictor; print('onnxruntime' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


# the hybrid: the room temperature, and the one twin that it belongs to


@pytest.fixture(scope="module", params=KINDS)
def hybrid(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> OnnxPredictor:
    return read_ham(write_onnx(tmp_path_factory.mktemp("ham") / "ham.onnx", request.param), TWIN, 60.0)


def hybrid_past(rows: int = 3) -> dict[str, Floats]:
    past = {name: np.full(rows, 20.0) for name in ("temp_air", "temp_ambient")}
    return past | {name: np.array([0.0] * (rows - 1) + [np.nan]) for name in ("heater_duty", "fan_on")}


def test_every_kind_of_hybrid_has_one_name(hybrid: OnnxPredictor) -> None:
    assert hybrid.name == "ham"
    assert hybrid.rows_needed == WINDOWS[hybrid.kind]


def test_the_room_drives_each_step(hybrid: OnnxPredictor) -> None:
    ahead = {"temp_ambient": np.array([20.0, 10.0, 30.0])}  # longer than the rollout
    temps = hybrid.rollout(hybrid_past(), np.zeros((2, 2, 2)), ahead)
    np.testing.assert_allclose(temps, [[22.0, 23.0]] * 2, rtol=1e-6)  # a tenth of the room each


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_unknown_room_gives_nan_from_its_step_on(value: float, hybrid: OnnxPredictor) -> None:
    ahead = {"temp_ambient": np.array([20.0, value, 20.0])}
    temps = hybrid.rollout(hybrid_past(), np.zeros((1, 3, 2)), ahead)
    np.testing.assert_allclose(temps, [[22.0, np.nan, np.nan]])


def test_the_newest_room_temperature_of_the_past_is_not_read(hybrid: OnnxPredictor) -> None:
    past = hybrid_past()
    past["temp_ambient"][-1] = np.nan
    temps = hybrid.rollout(past, np.zeros((1, 1, 2)), {"temp_ambient": np.array([20.0])})
    assert temps[0, 0] == pytest.approx(22.0)


def test_a_history_one_row_short_is_refused(hybrid: OnnxPredictor) -> None:
    rows = hybrid.rows_needed - 1
    with pytest.raises(DataError, match=f"history: {rows} rows, the ham model needs {rows + 1}"):
        hybrid.rollout(hybrid_past(rows) if rows else {"temp_air": np.empty(0)}, np.zeros((1, 1, 2)), {})


def test_a_room_out_of_the_box_is_flagged(hybrid: OnnxPredictor) -> None:  # the box ends at 40 °C
    controls = np.zeros((1, 1, 2))
    for room, is_outside in ((40.0, False), (40.1, True)):
        ahead = {"temp_ambient": np.array([room])}
        temps = hybrid.rollout(hybrid_past(), controls, ahead)
        assert outside_steps(hybrid.validity, hybrid_past(), controls, ahead, temps)[0, 0] == is_outside


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("twin", ["", "cd" * 32])
def test_a_hybrid_does_not_run_on_another_twin(kind: str, twin: str, tmp_path: Path) -> None:
    path = write_onnx(tmp_path / "ham.onnx", kind)
    with pytest.raises(
        DataError, match=rf"ham\.onnx: twin_sha256: trained on the twin {TWIN}, not on {twin}"
    ):
        read_ham(path, twin)


@pytest.mark.parametrize("value", ["", None])
def test_a_hybrid_says_which_twin_it_belongs_to(value: object, tmp_path: Path) -> None:
    path = write_onnx(tmp_path / "ham.onnx", "ham", changed={"twin_sha256": value})
    with pytest.raises(DataError, match=r"ham\.onnx: twin_sha256: .* is no hash of a twin"):
        read_ham(path, "")


def test_a_policy_gives_the_values_of_its_graph(tmp_path):
    policy = read_policy(policy_file(tmp_path / "p.onnx", favourite=3), "RL-Off", 60.0)
    observations = np.random.default_rng(1).normal(size=(5, len(FEATURES)))
    assert np.allclose(policy.values(observations), observations @ weights_of(3), atol=1e-3)
    assert (policy.name, policy.step_s, len(policy.version)) == ("RL-Off", 60.0, 12)


def golden(**changed):
    return document() | {"golden": document()["golden"] | changed}


@pytest.mark.parametrize(
    ("contract", "problem"),
    [
        (None, "greenhouse_policy: missing in the metadata"),
        (document() | {"policy": 2}, "policy: 2 is not 1"),
        (document() | {"table_sha256": "0" * 64}, "table_sha256: made with another table"),
        (document() | {"features": ["error"]}, "features: "),
        (document() | {"actions": 41}, "actions: 41 is not 42"),
        (document() | {"sample_s": 0}, "sample_s: 0 is not above 0"),
        (golden(observations=[]), "golden.observations: not numbers in 2 dimensions"),
        (golden(observations=[[1.0] * 12]), r"golden.observations: shape \(1, 12\), not \(1, 13\)"),
        (golden(values=[[0.0] * ACTIONS]), r"golden.values: shape \(1, 42\), not \(3, 42\)"),
        (golden(values=[[0.0] * ACTIONS] * 3), "golden.values: missed by 1e\\+02"),
        (document(favourite=8), "golden.values: missed by 1e\\+02"),
    ],
)
def test_a_file_that_breaks_its_word_is_refused_by_the_key(tmp_path, contract, problem):
    path = write(tmp_path / "p.onnx", graph(), contract)
    with pytest.raises(DataError, match=f"p.onnx: {problem}"):
        read_policy(path, "RL-Off")


def test_a_graph_of_another_shape_is_refused(tmp_path):
    path = write(tmp_path / "p.onnx", graph(features=5), document())
    with pytest.raises(DataError, match="inputs and outputs"):
        read_policy(path, "RL-Off")


def test_a_policy_for_another_step_is_refused(tmp_path):
    path = policy_file(tmp_path / "p.onnx", sample_s=30.0)
    with pytest.raises(DataError, match="sample_s: made for steps of 30 s, not of 60 s"):
        read_policy(path, "RL-Off", 60.0)


def test_a_policy_file_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(DataError, match="cannot be read"):
        read_policy(tmp_path / "none.onnx", "RL-Off")


# the table of the observation: what each row is, and that rig and training compute the same


NAN = math.nan


def test_a_box_at_rest_sees_its_error_and_how_it_is_heated():
    seen = by_name(observe_tick(context(24.0, 26.0, Command(heater_duty=0.35, fan_on=True), rows=40)))
    assert seen["error"] == 2.0
    assert seen["error_near"] == 1.0  # held within 1 K
    assert seen["above_room"] == 3.0  # the room of the tests has 21 °C
    assert [seen[name] for name in NAMES if name.startswith("change")] == [0.0, 0.0, 0.0]
    assert [seen[name] for name in NAMES if name.startswith("duty")] == [0.35] * 4
    assert [seen[name] for name in NAMES if name.startswith("fan")] == [1.0] * 3


def test_a_change_is_told_over_its_steps():
    here = context(rows=40)
    here.history["temp_air"][-6:] = [20.0, 21.0, 22.5, 23.0, 23.5, 24.0]
    seen = by_name(observe_tick(here))
    assert (seen["change_1"], seen["change_2"], seen["change_5"]) == (0.5, 1.0, 4.0)


def test_means_of_the_heater_cover_their_steps():
    here = context(rows=40)
    here.history["heater_duty"][:-1] = 0.0
    here.history["heater_duty"][-4:-1] = 1.0  # of the last three steps; the last row is not decided
    seen = by_name(observe_tick(here))
    assert seen["duty_1"] == 1.0
    assert [seen[f"duty_{steps}"] for steps in (5, 10, 30)] == pytest.approx([0.6, 0.3, 0.1])


def test_a_rig_that_has_just_begun_is_as_it_was_and_off_before():
    seen = by_name(observe_tick(context(24.0, 26.0, Command(heater_duty=1.0), rows=2)))
    assert seen["change_5"] == 0.0
    assert seen["duty_1"] == 1.0
    assert seen["duty_10"] == pytest.approx(0.1)


def test_only_the_present_reference_is_seen():
    steady, rising = context(reference=[25.0, 25.0]), context(reference=[25.0, 30.0])
    assert np.array_equal(observe_tick(steady), observe_tick(rising))


@pytest.mark.parametrize(
    ("column", "row", "named"),
    [
        ("temp_air", -1, "error, "),
        ("temp_air", -2, "change_1"),
        ("heater_duty", -2, "duty_1, duty_5"),
        ("fan_on", -3, "fan_5, fan_10"),
    ],
)
@pytest.mark.parametrize("unknown", [NAN, math.inf])
def test_what_is_not_known_is_refused_by_name(column, row, named, unknown):
    here = context(rows=40)
    here.history[column][row] = unknown
    with pytest.raises(DataError, match=f"observation: {named}"):
        observe_tick(here)


def test_an_unknown_room_or_reference_is_refused():
    here = context()
    with pytest.raises(DataError, match="above_room"):
        observe_tick(replace(here, estimate=replace(here.estimate, temp_ambient=NAN)))
    with pytest.raises(DataError, match="error"):
        observe_tick(replace(here, reference=np.array([NAN])))


def test_no_history_is_refused():
    here = context()
    none = {name: column[:0] for name, column in here.history.items()}
    with pytest.raises(DataError, match="no history"):
        observe_tick(replace(here, history=none))


def test_the_rig_sees_at_recorded_ticks_what_training_sees():
    columns = read_run(RUNS / "run_03.csv").columns
    temp, ambient, duty, fan = (
        columns[name] for name in ("temp_air_c", "temp_ambient_c", "heater_duty", "fan_on")
    )
    ends = np.arange(INPUT_ROWS, len(temp))
    recent = Recent(
        air=np.stack([temp[end - AIR_ROWS + 1 : end + 1] for end in ends]),
        duty=np.stack([duty[end - INPUT_ROWS : end] for end in ends]),
        fan=np.stack([fan[end - INPUT_ROWS : end] for end in ends]),
        ambient=ambient[ends],
        reference=np.full(len(ends), 27.5),
    )
    together = observe(recent)
    for row, end in enumerate(ends):
        history = {
            "temp_air": temp[: end + 1],
            "heater_duty": np.append(duty[:end], NAN),
            "fan_on": np.append(fan[:end], NAN),
        }
        here = replace(context(reference=27.5), history=history)
        here = replace(here, estimate=replace(here.estimate, temp_ambient=ambient[end]))
        assert np.array_equal(observe_tick(here), together[row])


def test_every_row_of_the_table_says_what_it_is():
    assert len(set(NAMES)) == len(FEATURES)
    assert all(feature.unit and feature.meaning and feature.scale > 0.0 for feature in FEATURES)


def test_another_table_has_another_hash(monkeypatch):
    before = table_sha256()
    changed = (replace(FEATURES[0], scale=FEATURES[0].scale * 2.0), *FEATURES[1:])
    monkeypatch.setattr(observation, "FEATURES", changed)
    assert table_sha256() != before
