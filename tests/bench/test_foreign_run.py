"""Solvers on cases: answers kept, failures too; what the peer says; the command that does it all."""

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from bench.foreign import __main__ as commands
from bench.foreign.peer import TERMS, sparse
from bench.foreign.run_cases import OURS, PYSINDY, SolverTask, case_sha256, is_done, run_one
from edge.commands import twin_benchmark
from edge.core.errors import RequestError
from edge.formats.run_file import RecordedRun, write_run
from edge.twin.model import BoxTwin

ROWS = 160
KNOWN = {"wall_loss": {"UA": 4.0}, "extra_capacity": {"kC": 5.0}}
NAMES = list(TERMS)


@pytest.fixture
def case(tmp_path: Path) -> Path:
    """Two training runs of a box with a lamp, which the twin file does not have."""
    folder = tmp_path / "case_1"
    folder.mkdir()
    (folder / "twin.yaml").write_text(
        "effects: {wall_loss: {UA: {fit: true, start: 2}}, extra_capacity: {kC: {value: 4, rel_sd: 0.3}}}\n"
        "sensor: {quantisation_k: 0.0, noise_sd_k: null}\n"
    )
    twin = BoxTwin(effects={**KNOWN, "led_gain": {"P_led": 20.0}})
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        duty = np.repeat(rng.integers(0, 13, ROWS // 10) / 20.0, 10)
        fan, light = (np.repeat(rng.random(ROWS // 20) < 0.4, 20).astype(float) for _ in range(2))
        room, start = np.full(ROWS, 20.0), np.array([[20.0]])
        shown = twin.rollout(start, duty[None], fan[None], room[None], conditions={"light": light[None]})[0]
        temp = np.concatenate([[20.0], shown[:-1]]) + 0.02 * rng.normal(size=ROWS)
        columns = {"time_s": 60.0 * np.arange(ROWS), "temp_air_c": temp, "temp_ambient_c": room,
                   "heater_duty": duty, "fan_on": fan, "light": light}  # fmt: skip
        write_run(RecordedRun(columns, {"role": "train"}), folder / f"train_{seed:02}.csv")
    return folder


def test_the_peer_names_a_lamp_and_its_answer_is_kept_with_its_seconds(case: Path, tmp_path: Path) -> None:
    task = SolverTask(PYSINDY, case, tmp_path / "out", 60.0)
    assert not is_done(task)
    assert run_one(task).startswith("case_1 pysindy")
    took = json.loads((task.out / "run.json").read_text())
    assert took["exit"] == 0, took["stderr"]
    assert took["wall_s"] > 0.0
    assert json.loads((task.out / "diagnosis.json").read_text())["effects"][0]["name"] == "led_gain"
    assert is_done(task)


def test_a_term_is_chosen_only_where_it_pays() -> None:
    rng = np.random.default_rng(3)
    terms, noise = rng.normal(size=(400, len(TERMS))), rng.normal(size=400)
    assert sparse(terms, 5.0 * terms[:, NAMES.index("heater_lag")] + noise) == ["heater_lag"]
    assert sparse(terms, np.zeros(400)) == []


def test_a_diagnosis_that_fails_is_kept_as_one_that_failed(case: Path, tmp_path: Path) -> None:
    (case / "twin.yaml").write_text("effects: {no_such_effect: {}}\n")
    out = tmp_path / "out"
    out.mkdir()
    (out / "diagnosis.json").write_text("{}")  # of an earlier run: it must not count
    assert "failed" in run_one(SolverTask(OURS, case, out, 60.0))
    took = json.loads((out / "run.json").read_text())
    assert took["exit"] != 0
    assert "no_such_effect" in took["stderr"]
    assert took["cpu_s"] > 0.0
    assert not (out / "diagnosis.json").exists()


def test_a_diagnosis_that_takes_too_long_is_stopped(case: Path, tmp_path: Path) -> None:
    run_one(SolverTask(OURS, case, tmp_path / "out", 0.01))
    took = json.loads((tmp_path / "out" / "run.json").read_text())
    assert took["exit"] != 0
    assert "stopped after 0.01 s" in took["stderr"]


def test_other_files_of_a_case_are_another_case(case: Path) -> None:
    before = case_sha256(case)
    (case / "twin.yaml").write_text("effects: {}\n")
    assert case_sha256(case) != before


def test_an_unknown_command_ends_with_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert commands.main(["win"]) == 2
    assert "score" in capsys.readouterr().out


def test_the_benchmark_makes_runs_and_scores_the_same_cases(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = argparse.ArgumentParser()
    twin_benchmark.add_arguments(parser)
    words = ["--quick", "--out", str(tmp_path), "--kinds", "none_such"]
    steps = twin_benchmark.steps(parser.parse_args(words))
    assert [step[0] for step in steps] == ["make", "run", "score"]
    assert len({tuple(step[1:]) for step in steps}) == 1
    for step in steps:  # each is understood: it is refused for the kind, not for its arguments
        assert commands.main(step) == 2
        assert "there is no kind 'none_such'" in capsys.readouterr().err


def test_without_a_checkout_the_benchmark_says_so(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="checkout"):
        twin_benchmark.refuse_without_checkout(tmp_path)
