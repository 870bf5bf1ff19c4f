"""Memory that survives a reset: the firmware's own bytes and the boot count, in memory or in a file."""

import json
from pathlib import Path


class StoreError(Exception):
    """A state file that can't be read; the text names it."""


class Eeprom:
    """The board's EEPROM. With a path every change is in the file before the next byte leaves the board."""

    def __init__(self, path: Path | None) -> None:
        """Errors: StoreError."""
        self._path = path
        self.persistent = b""
        self.boot_count = 0
        if path is not None and path.exists():
            self._load(path)

    def keep(self, persistent: bytes) -> None:
        """Remember the firmware's bytes."""
        if persistent != self.persistent:
            self.persistent = persistent
            self._save()

    def count_boot(self) -> None:
        """One boot more."""
        self.boot_count = (self.boot_count + 1) % 2**32
        self._save()

    def _load(self, path: Path) -> None:
        try:
            state = json.loads(path.read_text())
            self.persistent = bytes.fromhex(state["persistent"])
            self.boot_count = int(state["boot_count"])
        except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
            raise StoreError(f"{path}: no state of a virtual board: {error!r}") from error

    def _save(self) -> None:
        if self._path is None:
            return
        beside = self._path.with_name(self._path.name + ".new")
        beside.write_text(json.dumps({"persistent": self.persistent.hex(), "boot_count": self.boot_count}))
        beside.replace(self._path)
