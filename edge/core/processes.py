"""Processes of this software that the daemon starts, and the processors they share."""

import ctypes
import os
import signal
import subprocess
import sys
from pathlib import Path

_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG, linux/prctl.h


def processors() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0))


def environment() -> dict[str, str]:
    """Return this process's environment, with which `python -m edge...`
    finds the same software and packages.
    """
    root = Path(__file__).parents[2]
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path[1:]])}


def end_process(process: "subprocess.Popen[bytes]", patience_s: float) -> None:
    """Ask it to end, and kill it when it does not."""
    process.terminate()
    try:
        process.wait(timeout=patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def die_with_parent() -> None:
    """Also when the daemon is killed and can clean up nothing."""
    ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
