"""Learning algorithms compared: the same episodes and boards for all, regret by what knows no more."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from policy_files import policy_file

from edge.core.errors import DataError
from edge.formats.profile_file import Profile
from training.control import job as control_job
from training.control.comparison import RunResult
from training.control.job import ComparisonJob, run
from training.control.rig import ComparisonEntry
from training.data.datasets import training_runs
from training.rl import compare as rl_compare
from training.rl.command import POLICIES, folder_of
from training.rl.compare import (
    REFERENCE,
    AlgorithmFigures,
    JudgedPolicy,
    compare,
    head,
    regret_of,
    table,
    write,
)
from training.rl.saved_policy import POLICY_FILE, RECORD_FILE
from training.rl.study import world_of

RESULTS = Path(__file__).parents[3] / "training" / "results" / "control"
FIGURES = {"rig_mae_k": 0.4, "rig_mae_sensor_k": 0.3, "regret": 1.5, "decision_ms": 0.5}


@pytest.fixture(scope="module")
def world():
    return world_of("RL-Off", "pbm", training_runs("interpolation"))


def saved(folder: Path, seed: int, steps: int = 100_000) -> JudgedPolicy:
    folder.mkdir()
    policy_file(folder / POLICY_FILE)
    record = {"seed": seed, "cpu_s": 20.0, "command": "greenhouse-train rl", "settings": {"steps": steps}}
    (folder / RECORD_FILE).write_text(json.dumps(record))
    return JudgedPolicy("PPO", folder)


def run_result(entry: str, cost: float) -> RunResult:
    some = rl_compare.read_results(RESULTS)[0].figures
    return RunResult(entry, REFERENCE, 1, replace(some, sensor_cost_0=cost, sensor_cost_1=cost))


def test_regret_is_by_the_cheapest_that_knows_no_more():
    known = [
        run_result("clairvoyant/sensor", 1.0),  # knows the coming reference: no equal
        run_result("MPC-Twin", 2.0),
        run_result("clairvoyant/sensor/present", 10.0),
        run_result("MPC-Twin/present", 8.0),  # cheaper than its limit, which a beam may miss
        run_result("RL-Off", 4.0),  # gives way to the policy that is judged
    ]
    found = run_result("RL-Off", 12.0).figures
    assert regret_of(found, 1, "RL-Off", known) == pytest.approx(12.0 / 8.0)
    assert regret_of(found, 1, "MPC-Twin/present", known[:4]) == pytest.approx(12.0 / 10.0)
    with pytest.raises(DataError, match="board 1: no clairvoyant"):
        regret_of(found, 1, "RL-Off", known[-1:])


def test_each_policy_has_its_figures_and_the_planner_stands_beside(world, tmp_path, monkeypatch):
    boards = []
    monkeypatch.setattr(rl_compare, "JUDGED", 2)
    monkeypatch.setattr(rl_compare, "_on_rig", lambda job, *_: boards.append(job) or FIGURES)
    policies = [saved(tmp_path / f"seed_{seed}", seed) for seed in (0, 3)]
    found = list(compare(policies, world, tmp_path, RESULTS))
    assert [(one.algorithm, one.seed) for one in found] == [
        ("PPO", 0), ("PPO", 3), ("MPC-Twin/present", 0), ("MPC-Twin/present", 3),
    ]  # fmt: skip
    assert [job.seed for job in boards] == [1, 4, 1, 4]
    assert found[0].model_cost == found[1].model_cost > 0.0  # the same episodes for all
    assert found[0].onnx_bytes == policies[0].file.stat().st_size
    write(found, head("greenhouse-train rl-compare", world), tmp_path)
    rows = [line.split() for line in (tmp_path / "algorithms.txt").read_text().splitlines()]
    assert ["PPO", "all", "2"] in [row[:3] for row in rows]
    assert len(json.loads((tmp_path / "algorithms.json").read_text())) == 4


def test_trainings_of_other_lengths_are_not_compared(world, tmp_path):
    policies = [saved(tmp_path / "a", 0), saved(tmp_path / "b", 1, steps=50_000)]
    with pytest.raises(DataError, match=r"trainings of \[50000, 100000\] steps"):
        next(compare(policies, world, tmp_path, RESULTS))


def test_the_planner_decides_so_many_times_slower():
    own, planner = (
        AlgorithmFigures(name, 0, 1.0, 0.4, 0.4, 0.3, 1.5, ms, 20.0, 9_000)
        for name, ms in (("PPO", 0.5), ("MPC-Twin/present", 40.0))
    )
    assert "# PPO decides in 1/80 of the time of MPC-Twin/present" in rl_compare.text_of([own, planner], [])
    assert table([own]).rows[0][-1] == "9"


def test_a_rig_runs_the_policy_of_the_entry_and_another_file_is_another_run(tmp_path, monkeypatch):
    entry = ComparisonEntry("RL-Off/PPO/0", "RL-Off", policy=policy_file(tmp_path / "p.onnx"))
    job = ComparisonJob(entry, "tuning_1", 101)
    other = replace(entry, policy=policy_file(tmp_path / "q.onnx", favourite=9))
    assert replace(job, entry=other).sha256() != job.sha256()
    five_minutes = Profile({"time_s": np.array([0.0, 300.0])}, job.profile)
    monkeypatch.setattr(control_job, "read_profile", lambda path: five_minutes)
    log = run(job)
    assert not log.instead
    assert log.columns["heater_duty"][1] == 0.35  # its favourite where the air is too cold


def test_trainings_of_an_algorithm_have_a_folder_of_their_own():
    usual = folder_of(POLICIES, "RL-Off", "ham", 0, False)
    assert usual == POLICIES / "rl-off" / "ham" / "seed_0"
    assert folder_of(POLICIES, "RL-Off", "ham", 0, False, "QR-DQN").parts[-2] == "ham_qr-dqn"
