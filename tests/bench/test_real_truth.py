"""bench/real_truth: measured logs as cases, and what is said of them."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from bench.real_truth.__main__ import is_true, write
from bench.real_truth.logs import LOGS, SHARED, texts
from bench.reliability import main
from edge.core.errors import DataError
from edge.formats.run_file import read_run
from edge.twin.effects.library import EFFECTS
from edge.twin.twin_file import read_twin_file

RUN_FILE = "time_s,temp_air_c,heater_duty,temp_2_c\n" + "\n".join(
    f"{3 * k},{20 + 0.1 * k},0.5,19" for k in range(90)
)
KIT = next(log for log in LOGS if log.name == "lab kit, energy balance")


def test_names_are_those_of_the_library_and_a_log_is_in_one_split() -> None:
    for log in LOGS:
        assert set(log.main) | set(log.true) <= EFFECTS.keys()
        assert log.split in ("dev", "scored")
        assert log.source == SHARED or len(log.commit) >= 7
    assert len({log.name for log in LOGS}) == len(LOGS)


def test_a_log_becomes_a_case_that_is_divided_in_time(tmp_path: Path) -> None:
    write(KIT, tmp_path, [RUN_FILE])
    run = read_run(tmp_path / "train_01.csv")
    assert run.facts["validate_from_s"] == "174"
    assert set(run.columns) == {"time_s", "temp_air_c", "heater_duty"}  # nothing that its owner would not see
    file = read_twin_file(tmp_path / "twin.yaml")
    assert file.fan_role == "none"
    assert {".".join(place) for place in file.to_fit()} == {
        "effects.wall_loss.UA",
        "effects.extra_capacity.kC",
    }


def test_a_lab_kit_stores_time_0_twice_and_percent() -> None:
    kit = next(log for log in LOGS if log.name == "lab kit, another")
    columns = kit.read(",x,Time,T1,T2,Q1\n0,0,0.0,20.9,21,0.0\n1,1,0.0,20.9,21,50.0\n2,2,1.0,21.0,21,50.0\n")
    assert columns["time_s"].tolist() == [0.0, 1.0]
    assert columns["heater_duty"].tolist() == [0.5, 0.5]


def test_a_chamber_without_times_gets_them_by_its_pace() -> None:
    chamber = next(log for log in LOGS if log.name == "25 degC chamber, run 3")
    rows = "\n".join(f"{20 + 0.01 * k:.3f},50,400,1,{255 * (k % 2)}" for k in range(64))
    columns = chamber.read(f"si7021_c,si7021_h,set,input,output\n{rows}\n")
    assert np.diff(columns["time_s"]) == pytest.approx(16 / 3.28)
    assert set(np.unique(columns["heater_duty"])) <= {0.0, 1.0}


def test_what_is_known_of_a_rig_decides() -> None:
    assert is_true(KIT, "sensor_lag")
    assert is_true(KIT, "wall_mass")
    assert not is_true(KIT, "evapotranspiration")


def test_what_is_not_there_is_said_with_where_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="--data says where the logs lie"):
        texts(KIT, tmp_path, tmp_path)
    other = next(log for log in LOGS if log.source != SHARED)
    with pytest.raises(DataError, match=r"no clone of https://github\.com/"):
        texts(other, tmp_path, tmp_path)


def reader(name: str):
    return next(log for log in LOGS if log.name == name).read


def pickled(content: object) -> str:
    return pickle.dumps(content, 5).decode("utf-8", "surrogateescape")


def test_a_pickle_of_arrays_is_read() -> None:
    content = {"t": np.arange(6), "y": np.arange(12.0).reshape(2, 6), "u": np.full((2, 6), 40.0)}
    for text in (pickled(content), pickled({"first": content, "second": {}})):
        columns = reader("lab kit, excited")(text)
        assert columns["time_s"].tolist() == [0.0, 3.0]
        assert columns["temp_air_c"].tolist() == [0.0, 3.0]
        assert columns["heater_duty"].tolist() == [0.4, 0.4]


def test_a_pickle_that_would_run_something_is_refused() -> None:
    with pytest.raises(DataError, match="a pickle that asks for"):
        reader("lab kit, excited")(pickled(Path("/etc/passwd")))


def test_houses_plants_and_ovens_are_read_in_our_units() -> None:
    house = reader("house in winter")("Time,T_ext,P_hea,I_sol,T_int\n0.0,15,0,14,26\n1800.0,15,1250,100,27\n")
    assert house["time_s"].tolist() == [0.0, 1800.0]
    assert house["heater_duty"].tolist() == [0.0, 0.5]
    assert house["solar_w_m2"].tolist() == [14.0, 100.0]
    lines = [f"{0.1 * k:.2f} 2.5 2.4 {k % 2}.0 10.0 2.5" for k in range(41)]
    plant = reader("thermal plant")("\n".join(["Data", "", "Series 1", "", "Time T1 T2 setpoint", *lines]))
    assert plant["time_s"].tolist() == [0.0, 2.0, 4.0]
    assert plant["temp_air_c"].tolist() == [25.0, 25.0, 25.0]
    oven = reader("Peltier oven")("26.0, 23.8, 52.9\n" * 8)
    assert oven["time_s"].tolist() == [0.0, 1.0]
    assert oven["heater_duty"] == pytest.approx(0.529)
    lamp = reader("lamp over a plate")("   0.00   9.000  129.320\n   2.00   4.500  129.320\n")
    assert lamp["heater_duty"].tolist() == [0.9, 0.45]


def answered(folder: Path, names: dict[str, float], hidden: str) -> None:
    """A case with its truth, and an answer whose names have these probabilities."""
    for path, content in (
        (folder / "truth" / "case_1.json", {"hidden": {hidden: {}}}),
        (
            folder / "answers" / "case_1" / "diagnosis.json",
            {"effects": [{"name": name, "probability": said} for name, said in names.items()]},
        ),
    ):
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(content), encoding="utf-8")


def test_what_was_said_stands_beside_what_held(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    answered(tmp_path / "dev", {"heater_lag": 0.97, "soil_mass": 0.7}, hidden="heater_lag")
    assert main([f"foreign={tmp_path / 'dev'}", "--out", str(tmp_path / "diagram.png")]) == 0
    said = capsys.readouterr().out
    assert "foreign: 2 names" in said
    assert "0.95 to 1.00: said 0.97, held 1.00" in said
    assert "0.60 to 0.80: said 0.70, held 0.00" in said
    assert (tmp_path / "diagram.png").stat().st_size > 1000


def test_a_place_without_names_draws_an_empty_diagram(tmp_path: Path) -> None:
    (tmp_path / "dev" / "truth").mkdir(parents=True)
    assert main([f"foreign={tmp_path / 'dev'}", "--out", str(tmp_path / "diagram.png")]) == 0
    assert (tmp_path / "diagram.png").stat().st_size > 1000
