"""Processes of this software that the daemon starts, and the processors they share."""

import os
import sys
from pathlib import Path


def processors() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0))


def environment() -> dict[str, str]:
    """Return this process's environment, with which `python -m edge...`
    finds the same software and packages.
    """
    root = Path(__file__).parents[2]
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path[1:]])}
