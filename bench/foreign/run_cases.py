"""A solver on cases: `greenhouse twin diagnose` as a process that is given a case's folder, or a peer here.

An answer is diagnosis.json, and run.json with the seconds that it took, the exit code and what was said on
standard error. What has a run.json of its present files is done.
"""

import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from edge.core.errors import GreenhouseError
from edge.core.sweep import sweep

OURS, PYSINDY = "diagnose", "pysindy"
LIMIT_S = 600.0
_KEPT_CHARACTERS = 4000  # of standard error


class SolverTask(NamedTuple):
    """One solver on one case."""

    solver: str
    folder: Path
    out: Path
    limit_s: float


def run_all(tasks: Sequence[SolverTask], workers: int, dask: str | None = None) -> None:
    """Run the tasks side by side, a line for each."""

    def tell(done: int, task: SolverTask, line: str) -> None:
        print(f"{done}/{len(tasks)} {line}", flush=True)

    sweep(run_one, tasks, workers, dask, tell)


def run_one(task: SolverTask) -> str:
    """Run one task and write what came of it; a line that says so."""
    task.out.mkdir(parents=True, exist_ok=True)
    (task.out / "diagnosis.json").unlink(missing_ok=True)
    took = _diagnosis(task) if task.solver == OURS else _peer(task)
    _write(task.out / "run.json", {"case_sha256": case_sha256(task.folder), **took})
    said = "" if took["exit"] == 0 else f", failed: {took['stderr'].strip().splitlines()[-1:]}"
    return f"{task.folder.name} {task.solver} {took['wall_s']:.1f} s{said}"


def _diagnosis(task: SolverTask) -> dict[str, Any]:
    train, tests = (sorted(task.folder.glob(f"{role}_*.csv")) for role in ("train", "test"))
    tests = tests or train  # each divided in time
    command = [
        "nice", "-n", "10", sys.executable, "-m", "edge", "twin", "diagnose", *map(str, train),
        "--test", *map(str, tests), "--twin", str(task.folder / "twin.yaml"), "--out", str(task.out),
        "--json-only",
    ]  # fmt: skip
    # A session of its own: a diagnosis over its time is killed with all that it began.
    before, begun_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            stderr = process.communicate(timeout=task.limit_s)[1]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            stderr = f"{process.communicate()[1]}\nstopped after {task.limit_s:g} s"
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "exit": process.returncode,
        "wall_s": time.perf_counter() - begun_s,
        "cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "stderr": stderr[-_KEPT_CHARACTERS:],
    }


def _peer(task: SolverTask) -> dict[str, Any]:
    from bench.foreign.peer import (
        diagnose,
    )  # before the clock runs: importing pysindy takes longer than a case

    begun_s, cpu_s, stderr = time.perf_counter(), time.process_time(), ""
    try:
        _write(task.out / "diagnosis.json", diagnose(task.folder))
    except (GreenhouseError, ValueError, ArithmeticError) as error:  # a peer that can't is an answer, too
        stderr = repr(error)
    return {
        "exit": 1 if stderr else 0,
        "wall_s": time.perf_counter() - begun_s,
        "cpu_s": time.process_time() - cpu_s,
        "stderr": stderr,
    }


def _write(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def case_sha256(folder: Path) -> str:
    """Return a hash of everything that a solver is given."""
    digest = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def is_done(task: SolverTask) -> bool:
    """Return whether the task has an answer for its present files."""
    path = task.out / "run.json"
    if not path.exists():
        return False
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return bool(found["case_sha256"] == case_sha256(task.folder))
