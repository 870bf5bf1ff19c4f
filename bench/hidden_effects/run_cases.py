"""python -m bench.hidden_effects run: the diagnosis and the peers on every case, each case once.

Answers lie under <results>/<solver>/<case>/: diagnosis.json, and run.json with the seconds it took, the exit
code and what was said on standard error. A case that has a run.json of its present files is left as it is.
The diagnosis runs as a process that is given the case's folder and nothing else; peers run here.
"""

import argparse
import hashlib
import importlib
import importlib.util
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

from bench.hidden_effects.peers import PEERS, diagnose
from bench.hidden_effects.score import write_document
from bench.hidden_effects.score_case import add_place, cases_of
from edge.core import sweep
from edge.core.errors import DataError, GreenhouseError
from edge.core.processes import processors

OURS = "diagnose"
SOLVERS = (OURS, *PEERS)
LIMIT_S = 600.0
_KEPT_CHARACTERS = 4000  # of standard error


class SolverTask(NamedTuple):
    """One solver on one case."""

    solver: str
    folder: Path
    out: Path
    limit_s: float
    pictures: bool = False
    jobs: int = 1


def main(words: Sequence[str] | None = None) -> int:
    """Run what is missing; failures are kept as answers that are none."""
    parser = argparse.ArgumentParser(prog="python -m bench.hidden_effects run", description=__doc__)
    add_arguments(parser)
    arguments = parser.parse_args(words)
    results = arguments.results / arguments.suite / arguments.split
    jobs = max(1, processors() // arguments.workers)  # of one diagnosis
    tasks = [
        SolverTask(
            solver, folder, results / solver / folder.name, arguments.limit_s, arguments.pictures, jobs
        )
        for folder, _ in cases_of(arguments)
        for solver in _solvers(arguments.solvers)
    ]
    missing = [task for task in tasks if arguments.again or not is_done(task)]
    print(f"{len(tasks)} answers, {len(tasks) - len(missing)} of them there", flush=True)
    run_all(missing, arguments.workers, arguments.dask)
    return 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Those of `run`."""
    add_place(parser)
    parser.add_argument("--solvers", default=",".join(SOLVERS), help="comma between; default: %(default)s")
    sweep.add_arguments(parser)
    parser.add_argument("--limit-s", type=float, default=LIMIT_S, help="of one case; default: %(default)g")
    parser.add_argument("--pictures", action="store_true", help="the whole report, which takes seconds more")
    parser.add_argument("--again", action="store_true", help="also what has an answer")


def run_all(tasks: Sequence[SolverTask], workers: int, dask: str | None = None) -> None:
    """Run the tasks side by side, a line for each."""

    def tell(done: int, task: SolverTask, line: str) -> None:
        print(f"{done}/{len(tasks)} {line}", flush=True)

    sweep.sweep(run_one, tasks, workers, dask, tell)


def run_one(task: SolverTask) -> str:
    """Run one task and write what came of it; a line that says so."""
    if task.solver == "pysindy":  # before the clock runs: importing it takes longer than a case
        importlib.import_module("pysindy")
    task.out.mkdir(parents=True, exist_ok=True)
    (task.out / "diagnosis.json").unlink(missing_ok=True)
    took = _diagnosis(task) if task.solver == OURS else _peer(task)
    write_document(task.out / "run.json", {"case_sha256": case_sha256(task.folder), **took})
    said = "" if took["exit"] == 0 else f", failed: {took['stderr'].strip().splitlines()[-1:]}"
    return f"{task.folder.name} {task.solver} {took['wall_s']:.1f} s{said}"


def _solvers(words: str) -> list[str]:
    """Errors: DataError for one that there is not, or whose library is not installed."""
    names = words.split(",")
    if unknown := [name for name in names if name not in SOLVERS]:
        raise DataError(f"--solvers: there is no {unknown[0]!r}; there are {', '.join(SOLVERS)}")
    if "pysindy" in names and importlib.util.find_spec("pysindy") is None:
        raise DataError("--solvers: pysindy is not installed: pip install '.[dev]'")
    return names


def _diagnosis(task: SolverTask) -> dict[str, Any]:
    train, tests = (sorted(task.folder.glob(f"{role}_*.csv")) for role in ("train", "test"))
    tests = tests or train  # each divided in time
    command = [
        "nice", "-n", "10", sys.executable, "-m", "edge", "twin", "diagnose", *map(str, train),
        "--test", *map(str, tests), "--twin", str(task.folder / "twin.yaml"), "--out", str(task.out),
        "--jobs", str(task.jobs),
        *(() if task.pictures else ("--json-only",)),
    ]  # fmt: skip
    # A session of its own: a diagnosis over its time is killed with all its workers.
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
    begun_s, cpu_s, stderr = time.perf_counter(), time.process_time(), ""
    try:
        write_document(task.out / "diagnosis.json", diagnose(task.solver, task.folder))
    except (GreenhouseError, ValueError, ArithmeticError) as error:  # a peer that can't is an answer, too
        stderr = repr(error)
    return {
        "exit": 1 if stderr else 0,
        "wall_s": time.perf_counter() - begun_s,
        "cpu_s": time.process_time() - cpu_s,
        "stderr": stderr,
    }


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
