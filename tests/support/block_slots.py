"""The slots of a board's configuration: the one in force and a spare one, as C boards keep them in EEPROM."""

from firmware_protocol.board_block import BLOCK_SIZE, PART_BYTES, BoardKind, decode_block


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
