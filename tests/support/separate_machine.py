"""Run `greenhouse` as on another machine: python -m tests.support.separate_machine FOLDER COMMAND ...

FOLDER takes the place of /run/greenhouse and of the folder of demos; /etc/greenhouse is ignored. Otherwise
a stop of all rigs would also reach the rigs and demos of whoever runs the bench. With `--wait` the process
loads its modules, prints a line, and starts the command when it reads a line.
"""

import sys
import tempfile
from pathlib import Path

from edge.__main__ import main
from edge.app import running_rigs
from edge.commands import which_rig
from edge.config.settings import ControlSocketSettings

WAIT = "--wait"
LOADED = b"loaded\n"


def command(folder: Path, *words: str) -> list[str]:
    """Return the command line of `greenhouse` on the machine of this folder."""
    return [sys.executable, "-m", "tests.support.separate_machine", str(folder), *words]


def _run(folder: Path, words: list[str]) -> int:
    usual = ControlSocketSettings(str(folder / "control.sock"))
    tempfile.tempdir = str(folder)
    for module in (running_rigs, which_rig):
        setattr(module, "ControlSocketSettings", lambda: usual)  # noqa: B010  # mypy knows no such attribute
    which_rig.RIG_CONFIG = folder / "edge.yaml.of-no-rig"
    if words[0] == WAIT:
        sys.stdout.buffer.write(LOADED)
        sys.stdout.flush()
        sys.stdin.readline()
        words = words[1:]
    return main(words)


if __name__ == "__main__":
    raise SystemExit(_run(Path(sys.argv[1]), sys.argv[2:]))
