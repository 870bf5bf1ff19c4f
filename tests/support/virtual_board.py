"""A virtual board's process for tests: ready when it is handed over, surely dead afterwards."""

import itertools
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml

from edge.core.processes import die_with_parent

T = TypeVar("T")
CORES = {"python": "python", "c": "tests.support.c_core:boots"}
READY_S = 20.0  # the C core is compiled first


def on_cores_in_turn(cases: Iterable[T]) -> list[tuple[T, str]]:
    """Each case with one of the two cores, since tests/conformance holds the cores alike."""
    return list(zip(cases, itertools.cycle(CORES), strict=False))


@dataclass(frozen=True)
class VirtualBoard:
    """A running board and where to find it."""

    process: subprocess.Popen[str]
    port: Path
    control: Path

    def ask(self, **request: Any) -> dict[str, Any]:
        """One request over a control connection of its own."""
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(30)
            connection.connect(str(self.control))
            connection.sendall(json.dumps(request).encode() + b"\n")
            return dict(json.loads(connection.makefile().readline()))

    def truth(self) -> dict[str, Any]:
        """Return the true state of the box, which no sensor shows."""
        return self.ask(truth=True)

    def inject(self, **fault: Any) -> dict[str, Any]:
        """Start a fault now; its keys are those of a fault script."""
        return self.ask(fault=fault)


def command(directory: Path, *options: str) -> list[str]:
    """Return the command line of a board whose files are in `directory`."""
    program = [sys.executable, "-m", "firmware_protocol.virtual_board"]
    return [*program, "--link", str(directory / "port"), "--control", str(directory / "control"), *options]


@contextmanager
def virtual_board(
    directory: Path, *options: str, faults: list[dict[str, Any]] | None = None
) -> Iterator[VirtualBoard]:
    """Start a board with further command line `options` and a fault script; kill it at the end."""
    if faults is not None:
        script = directory / "faults.yaml"
        script.write_text(yaml.safe_dump(faults))
        options = (*options, "--faults", str(script))
    process = subprocess.Popen(
        command(directory, *options), stderr=subprocess.PIPE, text=True, preexec_fn=die_with_parent
    )
    board = VirtualBoard(process, directory / "port", directory / "control")
    try:
        _wait_until_ready(board)
        yield board
    finally:
        process.kill()
        process.communicate()


def _wait_until_ready(board: VirtualBoard) -> None:
    deadline = time.monotonic() + READY_S
    while time.monotonic() < deadline and board.process.poll() is None:
        try:
            board.ask(truth=True)
            return
        except (FileNotFoundError, ConnectionRefusedError):
            time.sleep(0.02)
    board.process.kill()
    raise AssertionError(f"the virtual board did not start: {board.process.communicate()[1]}")
