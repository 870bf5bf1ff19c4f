"""Measured logs through the diagnosis: how they are divided, told and checked. The logs are made up."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench import real_diagnosis
from bench.real_diagnosis import LogResult, Step, lines_of, measure
from bench.real_diagnosis_logs import LOG_SETS, TOLD, Logs, first_part, first_runs, read_logs
from bench.real_diagnosis_plate import HeaterStates, plate_of
from edge.formats.run_file import RecordedRun, read_run, write_run
from edge.twin.twin_file import read_twin_file

BOX = LOG_SETS["heated_box"]
# A plate that gives the air 0.8 W/K, which gives the room 5.5 W/K: the plate's own lag is 120 / 0.8 = 150 s.
PLATE_J_K, FILM_W_K, AIR_J_K, LOSS_W_K, ROOM_C = 120.0, 0.8, 2000.0, 5.5, 21.0


def log(seed: int, rows: int = 600) -> RecordedRun:
    """Rows of 1 s, steps of 0.0625 degC, the heater on and off for a minute or two; by Euler's method."""
    draw = np.random.default_rng(seed)
    duty = np.repeat(draw.choice([0.0, 0.5, 1.0], size=rows // 60 + 1), 60)[:rows]
    air, plate = np.empty(rows), np.empty(rows)
    air[0] = plate[0] = ROOM_C
    for k in range(rows - 1):
        given_w = FILM_W_K * (plate[k] - air[k])
        plate[k + 1] = plate[k] + (BOX.heater_w * duty[k] - given_w) / PLATE_J_K
        air[k + 1] = air[k] + (given_w - LOSS_W_K * (air[k] - ROOM_C)) / AIR_J_K
    read = np.round((air + draw.normal(0.0, 0.02, rows)) / 0.0625) * 0.0625
    return RecordedRun(
        {
            "time_s": np.arange(float(rows)),
            "temp_air_c": read,
            "temp_plate_c": plate,
            "heater_duty": duty,
            "fan_rpm": np.full(rows, 5500.0),
        }
    )


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    (folder / "heated_box").mkdir()
    for seed in range(10):
        write_run(log(seed), folder / "heated_box" / f"2022-03-{seed + 1:02}_fan.csv")
    return folder


@pytest.fixture(scope="module")
def case(data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Logs, LogResult]:
    folder = tmp_path_factory.mktemp("case")
    few = read_logs(data, BOX, lambda runs: first_part(runs[:3]))
    return folder, few, measure(folder, BOX, few)


def test_a_rest_begins_where_its_first_part_ends(case: tuple[Path, Logs, LogResult]) -> None:
    _, logs, result = case
    assert logs.train is logs.test
    train, test = result.diagnosis.data.train[0], result.diagnosis.data.test[0]
    assert len(train.run) == 72  # 120 rows of 5 s, 60 %
    assert test.from_s == 360.0
    # The forecast goes on from the last row that trained and is judged by those behind it.
    forecast = result.diagnosis.after.test[0]
    assert (forecast.start, len(forecast.residual)) == (71, 48)


def test_the_first_runs_by_date_train(data: Path) -> None:
    logs = read_logs(data, BOX, first_runs)
    assert [part.name[8:10] for part in logs.test] == ["09", "10"]
    assert len(logs.train) == 8


def test_a_recording_that_is_another_again_is_left_out(data: Path) -> None:
    logs = read_logs(data, replace(BOX, left_out=("2022-03-01_fan",)), first_runs)
    assert logs.train[0].name.startswith("2022-03-02")


def test_the_workflow_is_told_neither_plate_nor_fan_nor_room(case: tuple[Path, Logs, LogResult]) -> None:
    folder, logs, _ = case
    run = read_run(folder / logs.train[0].name)
    assert (tuple(run.columns), run.facts["role"]) == (TOLD, "train")


def test_capacity_and_loss_are_left_to_be_fitted(case: tuple[Path, Logs, LogResult]) -> None:
    file = read_twin_file(case[0] / "twin.yaml")
    assert [place[-1] for place in file.to_fit()] == ["kC", "UA"]
    assert file.sample_s == BOX.step_s


def test_the_heaters_lag_of_a_made_up_box_is_named_and_its_plate_told(
    case: tuple[Path, Logs, LogResult],
) -> None:
    result = case[2]
    assert [effect.name for effect in result.diagnosis.verdict.effects] == ["heater_lag"]
    assert result.steps[-1].test_k < result.given_step.test_k / 2.0
    assert result.plate is not None
    assert result.plate.correlation > 0.9


def test_the_table_has_what_was_measured(case: tuple[Path, Logs, LogResult]) -> None:
    _, logs, result = case
    table = "\n".join(lines_of("heated_box", "first part", logs, result))
    assert "3 parts train, 3 held out" in table
    assert f"+ heater_lag{result.steps[-1].train_k:38.3f}{result.steps[-1].test_k:10.3f}" in table
    assert "refuted by held-out runs: none" in table


def test_an_effect_with_which_held_out_runs_fit_worse_is_refuted(case: tuple[Path, Logs, LogResult]) -> None:
    steps = (Step("one mass", 1.0, 1.5), Step("+ heater_lag", 0.4, 1.1), Step("+ soil_mass", 0.2, 2.6))
    assert replace(case[2], steps=steps).refuted == ["+ soil_mass"]


def test_a_plate_in_proportion_to_the_heat_is_explained_whole() -> None:
    heat = np.linspace(0.0, 40.0, 50)
    air = np.full(50, 22.0)
    right = HeaterStates(air, heat, air + 1.5 + 0.8 * heat)
    found = plate_of([right], [right])
    assert (found.warmer_k_w, found.offset_k) == pytest.approx((0.8, 1.5))
    assert found.explained == pytest.approx(1.0)
    # A held-out plate that falls where the trained one rises: told the wrong way round.
    assert plate_of([right], [HeaterStates(air, heat, air - 0.8 * heat)]).correlation == pytest.approx(-1.0)


def test_where_the_data_are_missing_it_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert real_diagnosis.main(["--data", str(tmp_path), "--out", str(tmp_path)]) == 2
    assert "heated_box: no run files" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
