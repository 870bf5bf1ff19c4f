"""All runs of a comparison, each in a process of its own; those that are kept already are not repeated."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from edge.core.errors import GreenhouseError
from training.control.job import ComparisonJob, is_kept

POLL_S = 0.5
ENDING = (signal.SIGINT, signal.SIGTERM)
TAIL_CHARS = 2000  # of what a run that failed has said


def run_all(jobs: Sequence[ComparisonJob], root: Path, workers: int) -> None:
    """Do those that are missing, `workers` at a time. Errors: GreenhouseError with what a failed run said"""
    waiting = [job for job in jobs if not is_kept(job, root)]
    running: list[tuple[ComparisonJob, subprocess.Popen[str]]] = []
    with _signals_kept() as ended_by:
        try:
            while waiting or running:
                while waiting and len(running) < workers:
                    job = waiting.pop(0)
                    running.append((job, _start(job, root)))
                time.sleep(POLL_S)
                if ended_by:
                    raise KeyboardInterrupt
                for one in [one for one in running if one[1].poll() is not None]:
                    running.remove(one)
                    _told(*one, left=len(waiting) + len(running))
        finally:
            for _, process in running:
                process.terminate()
                process.communicate()


@contextmanager
def _signals_kept() -> Iterator[list[int]]:
    """Ctrl-C and SIGTERM wait in this list: amid a start they would leave a run that nobody ends."""
    kept: list[int] = []
    before = {each: signal.signal(each, lambda number, _: kept.append(number)) for each in ENDING}
    try:
        yield kept
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def _start(job: ComparisonJob, root: Path) -> "subprocess.Popen[str]":
    words = [job.entry.name, job.reference, str(job.seed), "--runs", str(root)]
    words += ["--llm-url", job.llm.url, "--llm-model", job.llm.model]
    return subprocess.Popen(
        [sys.executable, "-m", "training.control.job", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def _told(job: ComparisonJob, process: "subprocess.Popen[str]", left: int) -> None:
    _, said = process.communicate()
    name = f"{job.entry.name} on {job.reference}, seed {job.seed}"
    if process.returncode != 0:
        raise GreenhouseError(f"{name}: {said[-TAIL_CHARS:].strip()}")
    print(f"{name}: done, {left} left", flush=True)
