"""All runs of a comparison, each in a process of its own; those that are kept already are not repeated."""

import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from edge.errors import GreenhouseError
from training.control.job import Job, is_kept

POLL_S = 0.5
TAIL_CHARS = 2000  # of what a run that failed has said


def run_all(jobs: Sequence[Job], root: Path, workers: int) -> None:
    """Do those that are missing, `workers` at a time. Errors: GreenhouseError with what a failed run said"""
    waiting = [job for job in jobs if not is_kept(job, root)]
    running: list[tuple[Job, subprocess.Popen[str]]] = []
    before = signal.signal(signal.SIGTERM, _interrupt)  # so that no run is left behind without its parent
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                job = waiting.pop(0)
                running.append((job, _start(job, root)))
            time.sleep(POLL_S)
            for one in [one for one in running if one[1].poll() is not None]:
                running.remove(one)
                _told(*one, left=len(waiting) + len(running))
    finally:
        for _, process in running:
            process.terminate()
            process.wait()
        signal.signal(signal.SIGTERM, before)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def _start(job: Job, root: Path) -> "subprocess.Popen[str]":
    words = [job.entry.name, job.reference, str(job.seed), "--runs", str(root)]
    words += ["--llm-url", job.llm.url, "--llm-model", job.llm.model]
    return subprocess.Popen(
        [sys.executable, "-m", "training.control.job", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def _told(job: Job, process: "subprocess.Popen[str]", left: int) -> None:
    _, said = process.communicate()
    name = f"{job.entry.name} on {job.reference}, seed {job.seed}"
    if process.returncode != 0:
        raise GreenhouseError(f"{name}: {said[-TAIL_CHARS:].strip()}")
    print(f"{name}: done, {left} left", flush=True)
