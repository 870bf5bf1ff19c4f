"""Which tick numbers may have been given out: a few bytes alongside the history, overwritten in place.

Overwriting needs no free block, so it works on a full disk, where neither the database nor its log can grow.
A log that is damaged takes the newest ticks and their session with it; this file still knows of them.
"""

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

from edge.formats.atomic_file import open_to_overwrite
from edge.formats.input_file import read_file

_BYTES = 128  # always written whole, so that the file never grows after its first write


@dataclass(frozen=True, slots=True)
class Reservation:
    """Every number given out so far is below `below`."""

    first_seq: int  # first number of the session that wrote this
    below: int
    is_final: bool  # the session has ended, and the next number is `below` itself


class NumbersFile:
    """The file alongside the history at `history`."""

    def __init__(self, history: Path) -> None:
        self._path = Path(f"{history}-numbers")

    def read(self) -> Reservation | None:
        """Return the last reservation, None without a readable one."""
        try:
            values = json.loads(read_file(self._path)[:_BYTES])
            return Reservation(int(values["first_seq"]), int(values["below"]), bool(values["is_final"]))
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def write(self, reserved: Reservation) -> None:
        """Overwrite it on the disk itself. Errors: OSError"""
        file = open_to_overwrite(self._path)
        try:
            os.write(file, json.dumps(asdict(reserved)).encode().ljust(_BYTES))
            os.fsync(file)
        finally:
            os.close(file)
