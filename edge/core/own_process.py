"""Processes of this software that the daemon starts."""

import os
import sys
from pathlib import Path


def environment() -> dict[str, str]:
    """Return this process's environment, with which `python -m edge...`
    finds the same software and packages.
    """
    root = Path(__file__).parents[2]
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path[1:]])}
