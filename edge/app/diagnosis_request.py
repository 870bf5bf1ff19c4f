"""A diagnosis in a unit of its own: files through which the daemon asks, and the unit answers.

The daemon can start no process outside its own memory limit, so it writes a request into a folder; a path
unit of systemd sees it and starts `python -m edge.app.diagnosis_request FOLDER` with another limit. The
folder lives as long as the daemon: however the daemon ends, the folder is removed, and the command ends
with it.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from edge.formats.atomic_file import write_atomically
from edge.formats.cross_check import Rule
from edge.formats.reader import parse_json, read, read_bytes, read_json

GREENHOUSE = (sys.executable, "-m", "edge")
REQUEST, ANSWER = "request", "answer"
START_MAX_S = 120.0  # for systemd to take up a request, on a busy single-board computer
END_MAX_S = 60.0  # for an answer after the time that the request allows
LOOK_S = 0.5
LATE = "late"  # instead of an exit code


@dataclass(frozen=True, slots=True)
class UnitRequest:
    """The file through which the daemon asks."""

    words: Annotated[tuple[str, ...], Rule(least=1)]
    log: str
    patience_s: Annotated[float, Rule(above=0.0)]


@dataclass(frozen=True, slots=True)
class UnitAnswer:
    """The file through which the unit answers: an exit code, or LATE."""

    code: Any


class NoUnit(Exception):
    """The unit took up no request, or ended without an answer; the text says which."""


def ask(
    folder: Path, words: Sequence[str], log: Path, patience_s: float, is_over: Callable[[], bool]
) -> int | str:
    """Have `greenhouse *words` run by the unit.

    is_over : the daemon ends, and the unit with it
    Returns : its exit code, below 0 the signal that ended it; LATE
    Errors : NoUnit; DataError of an answer that can't be read
    """
    folder.mkdir(parents=True, exist_ok=True)
    request, answer = folder / REQUEST, folder / ANSWER
    answer.unlink(missing_ok=True)
    # Who sees the file sees all of it.
    asked = {"words": list(words), "log": str(log), "patience_s": patience_s}
    write_atomically(request, json.dumps(asked))
    try:
        _wait(lambda: not request.exists(), START_MAX_S, is_over, "greenhouse-diagnosis.path is not active")
        _wait(answer.exists, patience_s + END_MAX_S, is_over, "greenhouse-diagnosis.service gave no answer")
    except NoUnit:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    code = read_json(UnitAnswer, answer).code
    return code if isinstance(code, int) else LATE


def serve(folder: Path, program: Sequence[str] = GREENHOUSE) -> int:
    """Take the request and run it; whatever way the command ends, an answer says how."""
    content = read_bytes(folder / REQUEST)
    (folder / REQUEST).unlink()  # first of all: while it is there the path unit starts this again
    code: int | str = 1
    try:
        request = read(UnitRequest, parse_json(content))
        code = _run([*program, *request.words], Path(request.log), request.patience_s, folder)
    finally:
        if folder.exists():
            write_atomically(folder / ANSWER, json.dumps({"code": code}))
    return 0


def _run(command: Sequence[str], log: Path, patience_s: float, folder: Path) -> int | str:
    until = time.monotonic() + patience_s
    with log.open("ab") as out:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=out, start_new_session=True
        )
    try:
        while time.monotonic() < until and folder.exists():
            with suppress(subprocess.TimeoutExpired):
                return process.wait(LOOK_S)
        return LATE
    finally:
        with suppress(ProcessLookupError):  # whatever it started ends with it
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _wait(condition: Callable[[], bool], at_most_s: float, is_over: Callable[[], bool], failed: str) -> None:
    until = time.monotonic() + at_most_s
    while not condition():
        if is_over():
            raise NoUnit("the daemon ends")
        if time.monotonic() > until:
            raise NoUnit(failed)
        time.sleep(LOOK_S)


if __name__ == "__main__":
    sys.exit(serve(Path(sys.argv[1])))
