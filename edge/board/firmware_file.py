"""The boards' programs in firmware_protocol/hex, and how avrdude writes one so that no half is ever run.

The bootloaders write page by page in ascending order, so a flash that breaks off leaves the beginning of
the new program before the rest of the old one. Therefore everything is written with a first page of jumps to
themselves, and that page at last: until then a reset finds a board that drives nothing. (Beginning elsewhere
than at 0 is no way: the Mega's bootloader erases pages from 0 on, whatever the address is.)
"""

import hashlib
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import firmware_protocol
from edge.core.errors import DataError, RequestError
from firmware_protocol.board_block import BoardKind

FOLDER = Path(firmware_protocol.__file__).parent / "hex"
FLASH_S = 60.0  # at most for a stage; 20 kB take 5 s to write and to read again
_NAME = re.compile(r"(mega2560|uno)-(\d+)\.(\d+)\.(\d+)\.hex")
_JUMP_TO_ITSELF = b"\xff\xcf"
_ROW = 16  # bytes of a record


@dataclass(frozen=True, slots=True)
class BoardChip:
    """Microcontroller for avrdude. programmer : the bootloader's protocol"""

    part: str
    programmer: str
    page: int  # bytes


CHIPS = {
    BoardKind.MEGA2560: BoardChip("m2560", "wiring", 256),
    BoardKind.UNO: BoardChip("m328p", "arduino", 128),
}


@dataclass(frozen=True, slots=True)
class FirmwareFile:
    """A program of the package."""

    path: Path
    version: tuple[int, int, int]


def firmware_file(board: str, folder: Path = FOLDER) -> FirmwareFile:
    """Return the program for a board by its name in board.yaml. Errors: DataError where its hash is wrong"""
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        wanted, name = line.split()
        found = _NAME.fullmatch(name)
        if found is None or found[1] != board:
            continue
        path = folder / name
        if hashlib.sha256(path.read_bytes()).hexdigest() != wanted:
            raise DataError(f"{path}: damaged; its SHA-256 is not the one of SHA256SUMS")
        return FirmwareFile(path, (int(found[2]), int(found[3]), int(found[4])))
    raise DataError(f"{folder}: there is no program for {board}")


def write_stages(text: str, page: int, folder: Path) -> list[Path]:
    """Write the files of the stages of a program in Intel hex, in the order of their flashing."""
    rows = [line for line in text.splitlines() if line.startswith(":") and line[7:9] == "00"]
    first = [row for row in rows if int(row[3:7], 16) < page]
    rest = [row for row in rows if int(row[3:7], 16) >= page]
    stages = {"1-stopped.hex": [*_stopped_page(page), *rest], "2-first.hex": first}
    for name, lines in stages.items():
        (folder / name).write_text("\n".join([*lines, ":00000001FF"]) + "\n")
    return [folder / name for name in stages]


def _stopped_page(page: int) -> Iterator[str]:
    for address in range(0, page, _ROW):
        record = bytes([_ROW, address >> 8, address & 0xFF, 0]) + _JUMP_TO_ITSELF * (_ROW // 2)
        yield f":{record.hex().upper()}{-sum(record) & 0xFF:02X}"


def avrdude(kind: BoardKind, port: str, file: Path, baudrate: int = 115_200) -> None:
    """Write one file and verify it. Errors: RequestError, with the last lines that avrdude says"""
    chip = CHIPS[kind]
    command = ["avrdude", "-q", "-p", chip.part, "-c", chip.programmer, "-P", port, "-b", str(baudrate)]
    command += ["-D", "-U", f"flash:w:{file}:i"]  # -D: the other pages stay
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=FLASH_S, check=False)
    except FileNotFoundError:
        raise RequestError("avrdude is missing: apt install avrdude") from None
    except subprocess.TimeoutExpired:
        raise RequestError(f"avrdude did not end within {FLASH_S:.0f} s") from None
    if done.returncode != 0:
        lines = [
            line.removeprefix("avrdude ").strip() for line in done.stderr.splitlines() if "error" in line
        ]
        said = " / ".join(list(dict.fromkeys(lines))[-3:])
        raise RequestError(f"avrdude failed ({done.returncode}): {said}")
