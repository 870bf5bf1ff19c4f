"""The few values that must outlive the process: standing orders and latched trips.

A small JSON file, not the history database: it must be there when the database is not. Written in its own
thread, because a slow disk must not hold up control; written beside and renamed, so a power cut leaves the
old one or the new one and never half of one.
"""

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from edge.formats.atomic_file import write_atomically
from edge.formats.input_file import read_file
from edge.formats.strict_json import parse_object

RETRY_S = 10.0  # between two tries to write what a full or read-only disk did not take
ANSWERS_MAX = 200  # that wait for the disk; more come in a flood only

Answered = Callable[[str], None]  # called with "" when the values are on disk, else with the reason


class StateFileBroken(Exception):
    """The file is there and can't be understood; the text names it."""


def read(path: Path) -> dict[str, Any] | None:
    """Read the last document, None when nothing was ever written. Errors: StateFileBroken"""
    try:
        return parse_object(read_file(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise StateFileBroken(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise StateFileBroken(f"{path}: {error}") from error


def write(path: Path, values: dict[str, Any]) -> None:
    """Replace the file whole. Errors: OSError."""
    if not path.is_file():  # a FIFO, or a link to a device, would swallow the values
        path.unlink(missing_ok=True)
    write_atomically(path, json.dumps(values, indent=1))


class StateWriter:
    """Writes the newest values in a thread of its own; older ones that wait are dropped.

    What could not be written is tried again, so that a disk that recovers holds it.
    """

    def __init__(self, path: Path, pause_s: float = 0.0) -> None:
        """pause_s : between two writes, to spare a card; so much a power cut may cost"""
        self.path = path
        self._pause_s = pause_s
        self._condition = threading.Condition()
        self._next: dict[str, Any] | None = None
        self._unwritten: dict[str, Any] | None = None  # by the last try
        self._answers: list[Answered] = []
        self._closing = False
        self.failures = 0  # writes that did not reach the disk
        self.last_error = ""  # of the newest write, empty when it succeeded
        self._thread = threading.Thread(target=self._run, name="state-file", daemon=True)
        self._thread.start()

    def save(self, values: dict[str, Any], answered: Answered | None = None) -> None:
        """Hand over values; never waits, never raises.

        answered : called once, in the writer's thread, when these values or newer ones are on disk (file and
            folder synchronised), or could not be written; behind a disk that hangs the oldest of too many are
            answered at once, in the caller's thread
        """
        oldest = None
        with self._condition:
            self._next = values
            if answered is not None:
                oldest = self._answers.pop(0) if len(self._answers) == ANSWERS_MAX else None
                self._answers.append(answered)
            self._condition.notify()
        if oldest is not None:
            oldest("the disk does not answer")

    def close(self) -> None:
        """Write what waits, then end."""
        with self._condition:
            self._closing = True
            self._condition.notify()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._condition:
                timeout_s = None if self._unwritten is None else RETRY_S
                self._condition.wait_for(lambda: self._next is not None or self._closing, timeout_s)
                if self._next is None and self._closing:
                    return
                values, self._next = self._next or self._unwritten, None
                answers, self._answers = self._answers, []
            if values is not None:
                self._write(values, answers)
            with self._condition:
                self._condition.wait_for(lambda: self._closing, self._pause_s)

    def _write(self, values: dict[str, Any], answers: list[Answered]) -> None:
        try:
            write(self.path, values)
        except OSError as error:
            self.failures += 1
            self.last_error, self._unwritten = str(error), values
        else:
            self.last_error, self._unwritten = "", None
        for answered in answers:
            answered(self.last_error)
