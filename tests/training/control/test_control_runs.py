"""Runs of the comparison, and the references that they follow."""

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contexts import context

from edge.app.controllers import ControllerParts, make
from edge.config import loading as config
from edge.config.settings import ControlSettings
from edge.core.errors import DataError
from edge.formats.profile_file import read_profile
from edge.models.arx_file import read_arx
from training.control import job as control_job
from training.control.closed_loop import ClosedLoopLog, closed_loop, log_of
from training.control.draw_references import FOLDER, SEGMENTS, text
from training.control.job import ComparisonJob, is_kept, keep, read, run, run_all
from training.control.rig import entries

LENGTH_S = 900.0
SETTINGS = (
    "{timezone: UTC, control: {controller: rules}, drift: {enabled: false}, reference: {reference_c: 25}}"
)


@pytest.fixture(scope="module")
def near() -> ClosedLoopLog:
    with closed_loop(config.parse(SETTINGS, "test"), board="here", seed=3) as lab:
        lab.run(LENGTH_S / 60.0)
    return log_of(lab)


def test_a_run_has_a_row_for_every_minute(near):
    assert len(near.columns["time_s"]) == LENGTH_S / 60.0
    assert near.columns["heater_duty"].max() == 1.0
    assert near.instead == {}


def test_a_kept_run_comes_back(near, tmp_path):
    job = ComparisonJob(entries()["rules"], "tuning_1", 101)
    keep(job, near, tmp_path)
    back = read(job, tmp_path)
    np.testing.assert_array_equal(back.columns["true_air_c"], near.columns["true_air_c"])
    assert (back.changes, back.instead, back.tokens) == (near.changes, near.instead, near.tokens)


def test_a_kept_run_with_other_settings_is_another_run(near, tmp_path):
    job = ComparisonJob(entries()["MPC"], "tuning_1", 101)
    keep(job, near, tmp_path)
    other = replace(job, entry=replace(job.entry, control={"horizon": 5}))
    assert is_kept(job, tmp_path)
    assert not is_kept(other, tmp_path)
    with pytest.raises(DataError, match="tuning_1"):
        read(other, tmp_path)


def test_a_run_of_another_policy_is_another_run(tmp_path, monkeypatch):
    for name in ("rl-off", "rl-off-p"):
        (tmp_path / f"{name}.onnx").write_bytes(b"first")
    monkeypatch.setattr(control_job, "PACKAGED_FOLDER", tmp_path)
    job, other = (ComparisonJob(entries()[name], "tuning_1", 101) for name in ("RL-Off", "RL-Off-P"))
    before = job.sha256(), other.sha256()
    (tmp_path / "rl-off.onnx").write_bytes(b"second")
    assert (job.sha256() != before[0], other.sha256() == before[1]) == (True, True)


def test_what_is_kept_is_not_run_again(near, tmp_path, monkeypatch):
    job = ComparisonJob(entries()["rules"], "tuning_1", 101)
    keep(job, near, tmp_path)
    monkeypatch.setattr(control_job, "run", lambda job: pytest.fail("it was run"))
    run_all([job], tmp_path, workers=0)


def test_a_run_that_fails_says_why(tmp_path):
    with pytest.raises(Exception, match="no_such_reference"):
        run_all([ComparisonJob(entries()["rules"], "no_such_reference", 1)], tmp_path, workers=1)


def test_a_comparison_that_is_ended_leaves_no_run_behind(tmp_path):
    words = ["compare", "--controllers", "rules", "--references", "tuning_2", "--seeds", "101"]
    folders = [word for name in ("runs", "results", "images") for word in (f"--{name}", str(tmp_path / name))]
    with subprocess.Popen([sys.executable, "-m", "training", *words, *folders]) as comparison:
        give_up_s = time.monotonic() + 60.0
        # The run's, and that in which Python counts what processes share: it ends a little after the others.
        while len(started := _children(comparison.pid)) < 2 and time.monotonic() < give_up_s:
            time.sleep(0.05)
        comparison.terminate()
        assert comparison.wait(20.0) == 130
    assert len(started) == 2
    while any(Path(f"/proc/{pid}").exists() for pid in started):
        assert time.monotonic() < give_up_s


def _children(pid: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_the_twins_controller_runs_with_the_diagnosed_twin(tmp_path, monkeypatch):
    """A quarter of an hour of the whole daemon with a signed bundle of its own."""
    monkeypatch.setattr("training.control.job.FOLDER", tmp_path)
    (tmp_path / "short.csv").write_text("time_s,reference_c\n0,24\n900,24\n")
    log = run(ComparisonJob(entries()["MPC-Twin-P"], "short", 101))
    assert log.instead == {}
    assert abs(log.columns["sensor_air_c"][-1] + 0.4 - 24.0) < 0.7


def test_a_variant_is_another_run_with_a_controller_of_its_own():
    known = entries()
    hashes = {
        ComparisonJob(known[name], "reference_1", 1).sha256() for name in ("MPC-BFGS", "MPC-BFGS/unbounded")
    }
    assert len(hashes) == 2
    made = {
        name: control_job._instead(ComparisonJob(known[name], "reference_1", 1))
        for name in ("MPC-BFGS", "MPC-BFGS/unbounded", "rules/tuned")
    }
    assert made["MPC-BFGS"] is None  # the daemon's own
    cold = context(26.0, 27.0)
    daemons = {
        name: make(name, ControllerParts(ControlSettings(), read_arx())) for name in ("MPC-BFGS", "rules")
    }
    assert made["MPC-BFGS/unbounded"].decide(cold).command != daemons["MPC-BFGS"].decide(cold).command
    near = context(25.7, 26.0)
    assert made["rules/tuned"].decide(near).command.heater_duty == 1.0
    assert daemons["rules"].decide(near).command.heater_duty == 0.0


@pytest.mark.parametrize("name", SEGMENTS)
def test_the_kept_reference_is_the_drawn_one(name):
    assert (FOLDER / f"{name}.csv").read_text(encoding="utf-8") == text(name)


@pytest.mark.parametrize("name", SEGMENTS)
def test_a_reference_lies_where_the_box_can_follow(name):
    values = read_profile(FOLDER / f"{name}.csv").columns["reference_c"]
    assert values.min() >= 22.0
    assert values.max() <= 35.0


def test_the_references_are_as_long_as_the_papers():
    assert read_profile(FOLDER / "reference_1.csv").end_s == 212 * 60
    assert read_profile(FOLDER / "reference_2.csv").end_s == 24 * 3600
