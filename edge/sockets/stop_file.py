"""An emergency stop that waits on the disk for a daemon that does not answer.

Who stops the rig must not depend on the daemon: one that hangs reads no socket. Its board turns the heater
off by itself when the lease ends. The file sees to it that nothing heats again when the daemon goes on, or
another one starts after a kill or a power cut.
"""

import time
from contextlib import suppress
from pathlib import Path

from edge.core.hard_limits import LEASE_S
from edge.core.plain_text import plain
from edge.formats.atomic_file import make_folder, sync_folder, write_document
from edge.formats.input_file import open_file
from edge.formats.owner import as_owner
from edge.formats.reader import DocumentError, parse_json

FILE = "stop.json"
CONTENT_MAX = 1000  # bytes that are read of it
NOBODY = "somebody who left no name"
LEFT = (
    f"The daemon does not answer. Its board turns everything off by itself {LEASE_S:g} s after the daemon's "
    "last word, and the stop waits on the disk for the daemon: it will not heat again until it is released."
)


class StopFile:
    """A file in `folder`, which its writers and the daemon may change. What stands in it names the author."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE

    def leave(self, author: str) -> None:
        """Ask for a stop, on the disk when the call returns. Errors: OSError"""
        make_folder(self._path.parent)
        write_document(self._path, {"by": author, "utc": time.time()})

    def author(self) -> str | None:
        """Return who asks for a stop, None where nobody does. A file that cannot be read is one, too."""
        try:
            with open_file(self._path) as file:
                found = parse_json(file.read(CONTENT_MAX), FILE)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, DocumentError):
            return NOBODY
        return plain(str(found.get("by", ""))) or NOBODY

    def take_away(self) -> None:
        """Remove it: the stop is in force, and outlives this process. One that cannot be removed stays."""
        with suppress(OSError), as_owner(self._path):
            self._path.unlink()
            sync_folder(self._path.parent)
