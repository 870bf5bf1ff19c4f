"""bench/real_truth: measured logs as cases, and what is said of them."""

from pathlib import Path

import numpy as np
import pytest

from bench.real_truth.__main__ import is_true, write
from bench.real_truth.logs import LOGS, SHARED, texts
from edge.errors import DataError
from edge.run_file import read_run
from edge.twin.effects import EFFECTS
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
