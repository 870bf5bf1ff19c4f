"""bench/real_truth: measured logs as cases, and what is said of them."""

import io
import json
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from bench.real_truth import __main__ as real_truth
from bench.real_truth.__main__ import folder_name, is_true, report, write
from bench.real_truth.logs import LOGS, SHARED, texts
from bench.real_truth.readers import (
    air_duct,
    dryer,
    fan_calibration,
    greenhouse,
    hall,
    heat_shield,
    klipper,
    lines,
    plain,
    roaster,
    table,
    triacs,
)
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
        assert log.split in ("dev", "scored", "kept")
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


def git(*words: str | Path) -> None:
    subprocess.run(
        ["git", "-c", "user.name=a", "-c", "user.email=a", *words], check=True, capture_output=True
    )


@pytest.mark.parametrize("kind", [["--bare"], []])
def test_a_clone_is_found_by_its_owner_and_name(tmp_path: Path, kind: list[str]) -> None:
    git("init", tmp_path / "first")
    (tmp_path / "first" / "log.csv").write_text(RUN_FILE, encoding="utf-8")
    git("-C", tmp_path / "first", "add", ".")
    git("-C", tmp_path / "first", "commit", "-m", "a")
    git("clone", *kind, tmp_path / "first", tmp_path / "owner+name" / "repo")
    log = replace(KIT, source="owner/name", commit="HEAD", paths=("log.csv",))
    assert texts(log, tmp_path, tmp_path) == [RUN_FILE]


def answer(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Let the diagnosis say this of every case."""
    document = {
        "verdict": "named",
        "effects": [{"name": name, "probability": 0.97}],
        "gap": {"before": {"test": {"rmse_k": 2.0}}, "after": {"test": {"rmse_k": 1.0}}},
        "left_out": {"test_k": {"constant": 3.0}},
        "twin_after": "twin.yaml",
        "against_adopting": [],
    }

    def run_all(tasks, jobs) -> None:
        for task in tasks:
            task.out.mkdir(parents=True)
            (task.out / "diagnosis.json").write_text(json.dumps(document), encoding="utf-8")
            (task.out / "run.json").write_text(json.dumps({"stderr": "", "cpu_s": 1.0}), encoding="utf-8")

    monkeypatch.setattr(real_truth, "run_all", run_all)


def test_a_rig_of_which_nothing_is_known_counts_for_errors_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer(monkeypatch, "evapotranspiration")
    (tmp_path / "a.csv").write_text(RUN_FILE, encoding="utf-8")
    log = replace(KIT, paths=("a.csv",))
    said = report([log, replace(log, name="unknown", main=(), true=())], tmp_path, tmp_path, tmp_path)
    assert "evapotranspiration 0.97 FALSE" in said
    assert "unknown: named: evapotranspiration 0.97 ?" in said
    assert "named with 0.9 or more: 0 of 1" in said
    assert "that are false: 1 of 1" in said
    assert "at most 1.10 of the best simple model: 2 of 2" in said


def test_a_rig_of_which_nothing_is_known_says_nothing_of_probabilities(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for log in LOGS:
        path = tmp_path / "answers" / folder_name(log) / "diagnosis.json"
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps({"effects": [{"name": "heater_lag", "probability": 0.97}]}), "utf-8")
    assert main([f"measured={tmp_path}", "--out", str(tmp_path / "diagram.png")]) == 0
    known = sum(bool(log.main) for log in LOGS)
    assert known < len(LOGS)
    assert f"measured: {known} names" in capsys.readouterr().out


def test_a_table_is_read_by_its_columns_words_and_units() -> None:
    text = "t,a,b,on,room,sun\n1e9,20,22,False,19,0.1\n2e9,21,23,True,19,0.2\n3e9,,23,True,19,0.2\n"
    read = table("t", "a b", "on", tick_s=1e-9, temp_ambient_c="room", solar_w_m2="sun*1000")
    columns = read(text)
    assert columns["time_s"].tolist() == [0.0, 1.0]  # the row without a temperature is left out
    assert columns["temp_air_c"].tolist() == [21.0, 22.0]
    assert columns["heater_duty"].tolist() == [0.0, 1.0]
    assert columns["solar_w_m2"].tolist() == [100.0, 200.0]
    dated = table("t", "a", "p", full=2.0)("t,a,p\n2025-03-30 01:00:00,20,1\n2025-03-30 04:00:00,21,3\n")
    assert dated["time_s"].tolist() == [0.0, 10_800.0]
    assert dated["heater_duty"].tolist() == [0.5, 1.0]


def test_rows_left_out_leave_the_heat_they_brought() -> None:
    text = "head\n0 20 0\n1 21 255\n1 21 0\n2 22 255\n3 23 255\n"  # time 1 twice: the later row holds
    columns = plain("time_s temp_air_c heater_duty", heads=1, full=255.0, every=2)(text)
    assert columns["time_s"].tolist() == [0.0, 2.0]
    assert columns["temp_air_c"].tolist() == [20.0, 22.0]
    assert columns["heater_duty"].tolist() == [0.0, 1.0]


def test_a_printer_is_read_where_its_log_is_longest_without_a_break() -> None:
    told = (
        "Stats {}: gcodein=0 heater_bed: target=60 temp=5{}.0 pwm=0.5 extruder: target=0 temp=24.8 pwm=0.0\n"
    )
    text = "".join(told.format(time, k) for k, time in enumerate((1.0, 2.0, 90.0, 91.0, 92.0, 3.0)))
    columns = klipper("heater_bed", 1)(text)
    assert columns["time_s"].tolist() == [0.0, 1.0, 2.0]
    assert columns["temp_air_c"].tolist() == [52.0, 53.0, 54.0]
    assert columns["heater_duty"].tolist() == [0.5] * 3


def test_ovens_and_roasters_tell_what_holds() -> None:
    said = [(0, 257, 2000), (500, 769, 100), (1000, 257, 2100), (1500, 770, 50), (2000, 257, 2200)]
    columns = triacs("".join(json.dumps({"t": t, "cmd": cmd, "arg": arg}) + "\n" for t, cmd, arg in said))
    assert columns["time_s"].tolist() == [0.0, 1.0, 2.0]
    assert columns["temp_air_c"].tolist() == [20.0, 21.0, 22.0]
    assert columns["heater_duty"].tolist() == [0.0, 0.5, 0.75]
    roast = {
        "timex": [0.0, 1.5, 3.0, 4.5],
        "temp2": [100.0, -1.0, 101.0, 102.0],
        "specialevents": [0, 0, 3],
        "specialeventstype": [3, 0, 3],
        "specialeventsvalue": [6.0, 11.0, 11.0],
    }
    columns = roaster(repr(roast))
    assert columns["time_s"].tolist() == [0.0, 3.0, 4.5]
    assert columns["heater_duty"].tolist() == [0.5, 0.5, 1.0]
    console = lines(r"Time: ([\d.]+) s, Temp: ([\d.]+) C", "time_s heater_duty", 100.0)
    assert console("boot\nTime: 1.0 s, Temp: 40 C\n")["heater_duty"].tolist() == [0.4]


def matlab(**content: object) -> str:
    place = io.BytesIO()
    savemat(place, content)
    return place.getvalue().decode("utf-8", "surrogateescape")


def test_what_matlab_stored_is_read() -> None:
    shield = heat_shield(
        matlab(resultID=np.array([[20.0, 0.0], [20.5, 100.0], [21.0, 100.0], [22.0, 100.0]]))
    )
    assert shield["time_s"].tolist() == [0.0, 4.0]
    assert shield["heater_duty"].tolist() == [0.5, 1.0]
    volts = {"Heizung": 10.0 * np.eye(20)[:, :1], "Temperatur": np.full((20, 1), 21.0)}
    duct = air_duct(matlab(Zeit=0.01 * np.arange(20.0)[:, None], **volts))
    assert duct["time_s"] == pytest.approx([0.0, 0.1])
    assert duct["heater_duty"].tolist() == [0.1, 0.0]
    rows = np.arange(26.0).reshape(2, 13)
    crops = greenhouse(matlab(septemberiotdatasetstestmaturecrops=rows))
    assert crops["temp_air_c"].tolist() == [3.0, 16.0]
    assert crops["temp_ambient_c"].tolist() == [4.0, 17.0]
    assert crops["heater_duty"].tolist() == [11.0, 24.0]
    own = {f"sensor_temp_{i}": np.array([[19.0], [20.0 + i], [21.0 + i]]) for i in range(1, 5)}
    own |= {
        "time": np.array([[737999.0], [738000.0], [738000.125]]),
        "power": np.array([[0.0], [-2.0], [-6.0]]),
    }
    own |= {"weather_temp": np.zeros((3, 1)), "weather_rad": np.zeros((3, 1))}
    heated = hall(matlab(exp=own | {"time_str": "noon"}))
    assert heated["time_s"].tolist() == [0.0, 10_800.0]
    assert heated["temp_air_c"].tolist() == [22.5, 23.5]
    assert heated["heater_duty"].tolist() == [0.0, 1.0]


def test_a_calibration_tells_when_heat_and_fan_came_on() -> None:
    rows = "".join(f"{100 + 0.5 * k} {20 + k}\n" for k in range(6))
    columns = fan_calibration(
        f"pwm: 100.5 1.0\npwm: 101.5 0.0\n{rows}phase heatup start: 0\nphase heatup_fan start: 3"
    )
    assert columns["time_s"].tolist() == [0.0, 1.5]
    assert columns["heater_duty"] == pytest.approx([2 / 3, 0.0])
    assert columns["fan_on"].tolist() == [0.0, 1.0]


def test_a_dryer_tags_its_lines() -> None:
    columns = dryer(
        "76\tSENSORS_HEADER\theater_heater\tsilicagel_Fan\tsilicagel_C\text_C\n"
        "80\tSM_STATE\tregenerate\n"
        "1031\tSENSORS_VALUES\t78\t1\t43.5\t24.9\n11031\tSENSORS_VALUES\t0\t0\t43.0\t24.9\n"
    )
    assert columns["time_s"].tolist() == [0.0, 10.0]
    assert columns["heater_duty"].tolist() == [1.0, 0.0]
    assert columns["temp_ambient_c"].tolist() == [24.9, 24.9]


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


SCRIPT = """import glob, sys
files = sorted(glob.glob(sys.argv[1] + "/*.csv"))
rows = sum(1 for line in open(files[0])) - 1
print(f"x: {len(files)}x{rows} is the simplest within 5 % (1 K); held out 0.5 K")
"""


def test_the_script_gets_the_rows_of_a_case(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    text = "time_s,temp_air_c,heater_duty\n" + "\n".join(f"{3 * k},{20 + 0.1 * k},0.5" for k in range(300))
    for whole, said in ((True, "3x300"), (False, "1x301")):  # the fact that says where judging begins
        log, folder = replace(KIT, whole=whole, step_s=3.0), tmp_path / said
        write(log, folder, [text.replace(",0.5", f",0.{5 + k}") for k in range(3 if whole else 1)])
        assert real_truth.peer(sys.executable, script, folder, folder / "script") == (said, 0.5)
    script.write_text("import sys\nsys.exit('it failed')", encoding="utf-8")
    with pytest.raises(DataError, match=r"script\.py: \['it failed'\]"):
        real_truth.peer(sys.executable, script, folder, folder / "script")
