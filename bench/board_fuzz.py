"""python -m bench board_fuzz: the board's C code under the sanitizers, fed by chance.

Requests, damaged frames, noise, samples, answers of parts and configurations; the time wraps, the board
starts anew. Nothing may crash, overflow or heat against a latch (`board_fuzz.c`).
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from firmware_protocol.board_block import NO_PIN, BoardBlock, BoardKind, Part, PartConfig, encode_block
from tests.support.c_core import SOURCES, compile_board

SANITIZERS = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
_OUTPUTS = (7, 8, 9, 10, 11)
_SETS = (  # of parts, on an Uno
    (),
    (PartConfig(Part.SHT4X, 0x44), PartConfig(Part.DS18B20, 2, serial=1), PartConfig(Part.SCD4X, 0x62)),
    (PartConfig(Part.DHT22, 3), PartConfig(Part.HCSR04, 4, 5, first=400, last=100)),
    (PartConfig(Part.SHT3X, 0x45), PartConfig(Part.BH1750, 0x23, first=4000)),
    (PartConfig(Part.DS18B20, 2), PartConfig(Part.SOIL, 14, first=620, last=280)),
    (PartConfig(Part.DS18B20, 2, serial=7), PartConfig(Part.DS18B20, 2, outside=True, serial=8)),
    (PartConfig(Part.FLOAT, 12, first=1), PartConfig(Part.SHT4X, 0x46, outside=True)),
)


def blocks() -> bytes:
    """Return valid blocks, one after the other."""
    pins = ((NO_PIN,) * 5, _OUTPUTS)
    made = [BoardBlock(BoardKind.UNO, 7, pins=outputs, parts=parts) for outputs in pins for parts in _SETS]
    return b"".join(encode_block(block) for block in made)


def fuzz(count: int, seed: int) -> subprocess.CompletedProcess[str]:
    """Compile the program and run it once. count : bytes on the line"""
    with tempfile.TemporaryDirectory(prefix="board-fuzz-") as folder:
        drivers = sorted(str(path) for path in (SOURCES / "drivers").glob("*.c"))
        source = str(Path(__file__).with_suffix(".c"))
        program = compile_board(
            Path(folder) / "board_fuzz", source, *drivers, f"-I{SOURCES / 'drivers'}", *SANITIZERS
        )
        (Path(folder) / "blocks").write_bytes(blocks())
        command = [str(program), str(count), str(seed), str(Path(folder) / "blocks")]
        return subprocess.run(command, capture_output=True, text=True, check=False)


def main(words: Sequence[str] | None = None) -> int:
    """Print what happened; 1 after a crash, with what the sanitizers say."""
    parser = argparse.ArgumentParser(prog="python -m bench board_fuzz", description=__doc__)
    parser.add_argument("--bytes", type=float, default=1e8, metavar="N", help="on the line")
    parser.add_argument("--seed", type=int, default=1)
    told = parser.parse_args(words)
    done = fuzz(int(told.bytes), told.seed)
    print(f"seed {told.seed}, AddressSanitizer and UndefinedBehaviorSanitizer: ", end="")
    print("no crash" if done.returncode == 0 else f"ended with {done.returncode}")
    print(done.stdout, end="")
    print(done.stderr, end="", file=sys.stderr)
    return 0 if done.returncode == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
