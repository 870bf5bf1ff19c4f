"""The hybrid's file: the room temperature, and the one twin that it belongs to."""

from pathlib import Path

import numpy as np
import pytest
from onnx_files import TWIN, WINDOWS, write_onnx

from edge.core.errors import DataError
from edge.core.predictor import Floats
from edge.models.onnx_predictor import KINDS, OnnxPredictor, read_ham
from edge.models.validity import outside_steps


@pytest.fixture(scope="module", params=KINDS)
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> OnnxPredictor:
    return read_ham(write_onnx(tmp_path_factory.mktemp("ham") / "ham.onnx", request.param), TWIN, 60.0)


def history(rows: int = 3) -> dict[str, Floats]:
    past = {name: np.full(rows, 20.0) for name in ("temp_air", "temp_ambient")}
    return past | {name: np.array([0.0] * (rows - 1) + [np.nan]) for name in ("heater_duty", "fan_on")}


def test_every_kind_of_hybrid_has_one_name(model: OnnxPredictor) -> None:
    assert model.name == "ham"
    assert model.rows_needed == WINDOWS[model.kind]


def test_the_room_drives_each_step(model: OnnxPredictor) -> None:
    ahead = {"temp_ambient": np.array([20.0, 10.0, 30.0])}  # longer than the rollout
    temps = model.rollout(history(), np.zeros((2, 2, 2)), ahead)
    np.testing.assert_allclose(temps, [[22.0, 23.0]] * 2, rtol=1e-6)  # a tenth of the room each


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_unknown_room_gives_nan_from_its_step_on(value: float, model: OnnxPredictor) -> None:
    ahead = {"temp_ambient": np.array([20.0, value, 20.0])}
    temps = model.rollout(history(), np.zeros((1, 3, 2)), ahead)
    np.testing.assert_allclose(temps, [[22.0, np.nan, np.nan]])


def test_the_newest_room_temperature_of_the_past_is_not_read(model: OnnxPredictor) -> None:
    past = history()
    past["temp_ambient"][-1] = np.nan
    temps = model.rollout(past, np.zeros((1, 1, 2)), {"temp_ambient": np.array([20.0])})
    assert temps[0, 0] == pytest.approx(22.0)


def test_a_history_one_row_short_is_refused(model: OnnxPredictor) -> None:
    rows = model.rows_needed - 1
    with pytest.raises(DataError, match=f"history: {rows} rows, the ham model needs {rows + 1}"):
        model.rollout(history(rows) if rows else {"temp_air": np.empty(0)}, np.zeros((1, 1, 2)), {})


def test_a_room_out_of_the_box_is_flagged(model: OnnxPredictor) -> None:  # the box ends at 40 °C
    controls = np.zeros((1, 1, 2))
    for room, is_outside in ((40.0, False), (40.1, True)):
        ahead = {"temp_ambient": np.array([room])}
        temps = model.rollout(history(), controls, ahead)
        assert outside_steps(model.validity, history(), controls, ahead, temps)[0, 0] == is_outside


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
