"""edge/models/onnx_predictor.py: models behind an ONNX file, whose forecasts can be added up by hand."""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from onnx_files import TWIN, WINDOWS, write_onnx

from edge.core.errors import DataError
from edge.core.predictor import Floats
from edge.models.onnx_predictor import BATCH, KINDS, OnnxPredictor, read_ham, read_lstm
from edge.models.validity import outside_steps


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
