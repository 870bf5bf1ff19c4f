"""Memory that survives a reset: the firmware's own bytes and the boot count, in memory or in a file."""

import json
from pathlib import Path

from firmware_protocol.board_block import BLOCK_SIZE, PART_BYTES, BoardKind, decode_block


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


class BlockSlots:
    """The block of the configuration in force and a spare one. roms : ROM codes of the parts on the 1-Wire"""

    def __init__(
        self, kind: BoardKind, block: bytes = b"\xff" * BLOCK_SIZE, roms: tuple[int, ...] = ()
    ) -> None:
        self.roms = roms
        self._unfound: list[int] = []
        self.kind = kind
        self.block = block
        self.spare = bytearray(b"\xff" * BLOCK_SIZE)

    def read(self, part: int) -> bytes:
        """Return 16 bytes of the one in force."""
        return self.block[part * PART_BYTES :][:PART_BYTES]

    def write(self, part: int, data: bytes) -> bytes:
        """Write 16 bytes of the spare one, and return what it then holds there."""
        self.spare[part * PART_BYTES : (part + 1) * PART_BYTES] = data
        return bytes(data)

    def commit(self) -> bool:
        """Take the spare one into force; False, and nothing changes, for a bad one."""
        try:
            good = decode_block(bytes(self.spare)).kind is self.kind
        except ValueError:
            return False
        if good:
            self.block, self.spare = bytes(self.spare), bytearray(self.block)
        return good

    def find(self, first: bool) -> int:
        """Return the ROM code of the next part on the 1-Wire, 0 for none."""
        if first:
            self._unfound = list(self.roms)
        return self._unfound.pop(0) if self._unfound else 0
