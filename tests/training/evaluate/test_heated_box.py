"""The models on a real box: how its runs are divided, fitted and forecast. The runs here are made up."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.core.predictor import Columns, Floats
from edge.formats.run_file import RecordedRun, write_run
from edge.twin.geometry import Geometry
from edge.twin.model import BoxTwin
from training import __main__
from training.evaluate import heated_box
from training.evaluate.heated_box import HEATER_MASS, HORIZONS_S, fit_box, maes, read_data

GEOMETRY = replace(Geometry(), heater_max_w=heated_box.HEATER_W, volume_m3=heated_box.VOLUME_M3)
EFFECTS = {"extra_capacity": {"kC": 20.0}, "wall_loss": {"UA": 1.5}, "heater_lag": {"tau_h": 60.0}}
ROOM_C = 19.0


class Held:
    """Persistence as a predictor."""

    name, version, step_s, rows_needed = "held", "", 10.0, 1

    def rollout(self, history: Columns, controls: Floats, ahead: Columns) -> Floats:
        return np.full(controls.shape[:2], history["temp_air"][-1])


def box_run(seed: int, rows: int = 601) -> RecordedRun:
    """Ten minutes at 1 s of a box with a heater's mass, from the room's temperature, without noise."""
    twin = BoxTwin(geometry=GEOMETRY, effects=EFFECTS, step_s=1.0)
    draw = np.random.default_rng(seed)
    duty = np.repeat(draw.choice([0.0, 0.5, 1.0], size=11), 60)[:rows]
    start = np.array([ROOM_C, 0.0])
    temp = twin.rollout(start, duty[None, :-1], np.zeros((1, rows - 1)), ROOM_C)[0]
    columns = {"time_s": np.arange(float(rows)), "temp_air_c": np.append(ROOM_C, temp), "heater_duty": duty}
    return RecordedRun(columns)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("heated_box")
    for seed in range(14):
        write_run(box_run(seed), path / f"2022-03-{seed + 1:02}_fan.csv")
    return path


def test_where_the_data_are_missing_it_says_where_to_get_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert __main__.main(["heated-box", "--data", str(tmp_path), "--results", str(tmp_path)]) == 2
    assert "https://github.com/grobx/unimi-embedded-project" in capsys.readouterr().err


def test_the_runs_are_divided_by_date(folder: Path) -> None:
    data = read_data(folder)
    names = [
        [run.path.stem[8:10] for run in runs if run.path]
        for runs in (data.parts.train, data.parts.validate, data.test)
    ]
    assert names == [["01", "02", "03", "04", "05"], ["06", "07", "08"], ["09", "10", "11", "12", "13", "14"]]
    assert len(data.test[0]) == 61  # 600 s at 10 s


def test_nothing_is_fitted_on_a_test_run(folder: Path) -> None:
    with pytest.raises(DataError, match="test run"):
        fit_box(read_data(folder).test, HEATER_MASS)


def test_the_twin_with_the_heaters_mass_finds_the_box_that_made_the_runs(folder: Path) -> None:
    data = read_data(folder)
    box = fit_box(data.parts.train, HEATER_MASS)
    assert box.ambient_c == pytest.approx(ROOM_C, abs=0.5)
    # Its hidden state starts at a guess; what a box of one mass misses here is ten times that.
    errors = maes(box.predictor, data.test, box.ambient_c)
    assert errors.max() < 0.05
    mass = fit_box(data.parts.train, heated_box.ONE_MASS)
    assert errors.max() < 0.2 * maes(mass.predictor, data.test, mass.ambient_c).max()


def test_a_predictor_that_holds_is_persistence(folder: Path) -> None:
    data = read_data(folder)
    held = maes(Held(), data.test, ROOM_C)
    assert held.shape == (len(HORIZONS_S),)
    measured = [run.columns["temp_air_c"] for run in data.test]
    steps = round(HORIZONS_S[-1] / heated_box.STEP_S)
    by_hand = np.concatenate([np.abs(temp[9 + steps :] - temp[9:-steps]) for temp in measured])
    assert held[-1] == pytest.approx(by_hand.mean(), abs=1e-12)
