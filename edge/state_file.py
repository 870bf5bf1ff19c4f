"""The few values that must outlive the process: standing orders and latched trips.

A small JSON file, not the history database: it must be there when the database is not. Written in its own
thread, because a slow disk must not hold up control; written beside and renamed, so a power cut leaves the
old one or the new one and never half of one.
"""

import json
import os
import threading
from pathlib import Path
from typing import Any

from edge.input_file import read_file
from edge.strict_json import parse_object


class StateFileBroken(Exception):
    """The file is there and can't be understood; the text names it."""


def read(path: Path) -> dict[str, Any] | None:
    """What was last written, or None when nothing ever was. Errors: StateFileBroken."""
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
    beside = path.with_name(path.name + ".new")
    with beside.open("w") as file:
        json.dump(values, file, indent=1)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
    directory = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


class StateWriter:
    """Writes the newest values in a thread of its own; older ones that wait are dropped."""

    def __init__(self, path: Path, pause_s: float = 0.0) -> None:
        """pause_s : between two writes, to spare a card; so much a power cut may cost"""
        self.path = path
        self._pause_s = pause_s
        self._condition = threading.Condition()
        self._next: dict[str, Any] | None = None
        self._closing = False
        self.failures = 0  # writes that did not reach the disk
        self.last_error = ""  # of the newest write, empty when it succeeded
        self._thread = threading.Thread(target=self._run, name="state-file", daemon=True)
        self._thread.start()

    def save(self, values: dict[str, Any]) -> None:
        """Never waits, never raises."""
        with self._condition:
            self._next = values
            self._condition.notify()

    def close(self) -> None:
        """Write what waits, then end."""
        with self._condition:
            self._closing = True
            self._condition.notify()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._next is not None or self._closing)
                values, self._next = self._next, None
            if values is None:
                return
            try:
                write(self.path, values)
            except OSError as error:
                self.failures += 1
                self.last_error = str(error)
            else:
                self.last_error = ""
            with self._condition:
                self._condition.wait_for(lambda: self._closing, self._pause_s)
