"""Running the benchmark: answers kept, failures too; what the peers say; the command that does it all."""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bench.hidden_effects import __main__ as commands
from bench.hidden_effects.peers import diagnose, stepwise
from bench.hidden_effects.peers_regression import TERMS, OneStepRegression
from bench.hidden_effects.run_cases import OURS, SolverTask, case_sha256, run_one
from bench.hidden_effects.score_case import answer
from edge.commands import twin_benchmark
from edge.core.errors import RequestError
from edge.formats.run_file import RecordedRun, write_run
from edge.twin.model import BoxTwin
from edge.twin.twin_file import TwinFile, write_twin_file
from edge.twin.value import Value

ROWS = 160
KNOWN = {"wall_loss": {"UA": 4.0}, "extra_capacity": {"kC": 5.0}}
NAMES = [term.effect for term in TERMS]


def case(folder: Path, led_w: float) -> Path:
    """Two training runs and a test run of a box with a lamp, which the twin file does not have."""
    folder.mkdir()
    file = TwinFile(effects={name: {key: Value(x) for key, x in own.items()} for name, own in KNOWN.items()})
    write_twin_file(file, folder / "twin.yaml")
    twin = BoxTwin(effects={**KNOWN, "led_gain": {"P_led": led_w}})
    for seed, name in enumerate(("train_01.csv", "train_02.csv", "test_01.csv")):
        rng = np.random.default_rng(seed)
        duty = np.repeat(rng.integers(0, 13, ROWS // 10) / 20.0, 10)
        fan, light = (np.repeat(rng.random(ROWS // 20) < 0.4, 20).astype(float) for _ in range(2))
        room, start = np.full(ROWS, 20.0), np.array([[20.0]])
        shown = twin.rollout(start, duty[None], fan[None], room[None], conditions={"light": light[None]})[0]
        temp = np.concatenate([[20.0], shown[:-1]]) + 0.02 * rng.normal(size=ROWS)
        if name.startswith("test"):
            temp[2:] = np.nan
        columns = {"time_s": 60.0 * np.arange(ROWS), "temp_air_c": temp, "temp_ambient_c": room,
                   "heater_duty": duty, "fan_on": fan, "light": light}  # fmt: skip
        write_run(RecordedRun(columns, {"role": name[:-7]}), folder / name)
    return folder


def test_a_lamp_is_named_by_the_regression_and_forecast(tmp_path: Path):
    found = answer(diagnose("stepwise", case(tmp_path / "case_1", led_w=20.0)))
    assert found.effects[0].name == "led_gain"
    low, high = found.effects[0].intervals["P_led"]
    assert low < 20.0 < high
    after, before = found.after["test_01.csv"], found.before["test_01.csv"]
    assert len(after) == len(before) == ROWS
    assert np.isfinite(after).all()
    assert after.max() > before.max() + 1.0  # 20 W into 4 W/K, part of the time


def test_pysindy_names_it_too(tmp_path: Path):
    found = answer(diagnose("pysindy", case(tmp_path / "case_1", led_w=20.0)))
    assert found.effects[0].name == "led_gain"


def test_a_term_is_chosen_only_where_it_pays():
    rng = np.random.default_rng(3)
    terms = rng.normal(size=(400, len(TERMS)))
    noise = rng.normal(size=400)
    lamp = NAMES.index("led_gain")
    assert stepwise(OneStepRegression(noise + terms[:, lamp], terms, np.ones(400)))[0] == lamp
    assert stepwise(OneStepRegression(np.zeros(400), terms, np.ones(400))) == []


def test_a_peers_answer_is_kept_with_its_seconds(tmp_path: Path):
    folder = case(tmp_path / "case_1", led_w=20.0)
    task = SolverTask("stepwise", folder, tmp_path / "out", 60.0)
    assert run_one(task).startswith("case_1 stepwise")
    took = json.loads((task.out / "run.json").read_text())
    assert took["exit"] == 0
    assert took["wall_s"] > 0.0
    assert took["case_sha256"] == case_sha256(folder)
    assert json.loads((task.out / "diagnosis.json").read_text())["verdict"] == "named"


def test_a_diagnosis_that_fails_is_kept_as_one_that_failed(tmp_path: Path):
    folder = tmp_path / "case_1"
    folder.mkdir()
    (folder / "twin.yaml").write_text("effects: {no_such_effect: {}}\n")
    out = tmp_path / "out"
    out.mkdir()
    (out / "diagnosis.json").write_text("{}")  # of an earlier run: it must not count
    assert "failed" in run_one(SolverTask(OURS, folder, out, 60.0))
    took = json.loads((out / "run.json").read_text())
    assert took["exit"] != 0
    assert took["stderr"]
    assert took["cpu_s"] > 0.0
    assert not (out / "diagnosis.json").exists()


def test_a_diagnosis_that_takes_too_long_is_stopped(tmp_path: Path):
    folder = case(tmp_path / "case_1", led_w=20.0)
    run_one(SolverTask(OURS, folder, tmp_path / "out", 0.01))
    took = json.loads((tmp_path / "out" / "run.json").read_text())
    assert took["exit"] != 0
    assert "stopped after 0.01 s" in took["stderr"]


def test_other_files_of_a_case_are_another_case(tmp_path: Path):
    folder = case(tmp_path / "case_1", led_w=20.0)
    before = case_sha256(folder)
    (folder / "twin.yaml").write_text("effects: {}\n")
    assert case_sha256(folder) != before


def test_an_unknown_command_or_place_ends_with_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert commands.main(["win"]) == 2
    assert "score" in capsys.readouterr().out
    assert commands.main(["score", "--suite", "equations", "--root", str(tmp_path)]) == 2
    assert "make them first" in capsys.readouterr().err


def benchmark(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    twin_benchmark.add_arguments(parser)
    return parser.parse_args(words)


def test_the_benchmark_makes_runs_and_scores_the_same_cases(tmp_path: Path):
    make, run, score = twin_benchmark.steps(
        benchmark("--quick", "--out", str(tmp_path), "--kinds", "null,pair")
    )
    assert [step[0] for step in (make, run, score)] == ["make", "run", "score"]
    for step in (make, run, score):
        assert step[step.index("--per-kind") + 1] == "2"
        assert step[step.index("--kinds") + 1] == "null,pair"
        assert step[step.index("--split") + 1] == "scored"
    assert make[make.index("--out") + 1] == run[run.index("--root") + 1] == str(tmp_path / "cases")


def test_every_step_of_the_benchmark_is_understood(tmp_path: Path):
    for step in twin_benchmark.steps(benchmark("--out", str(tmp_path), "--kinds", "none_such")):
        command = [sys.executable, "-m", twin_benchmark.BENCH, *step]
        done = subprocess.run(
            command, cwd=twin_benchmark.CHECKOUT, capture_output=True, text=True, check=False
        )
        assert done.returncode == 2
        assert "none_such" in done.stdout + done.stderr  # refused for the kind, not for its arguments
        assert "usage" not in done.stderr


def test_without_a_checkout_the_benchmark_says_so(tmp_path: Path):
    with pytest.raises(RequestError, match="checkout"):
        twin_benchmark.refuse_without_checkout(tmp_path)
