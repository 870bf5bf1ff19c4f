"""The boards that one suite runs over: Python, C, and C under the sanitizers in a process of its own."""

import struct
import subprocess
from pathlib import Path

from block_slots import BlockSlots

from firmware_protocol.board_block import BoardKind
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.core import BoardCore, Pins
from tests.support.c_core import (
    SIGNALS,
    compile_board,
    raw_config,
    raw_quality,
    raw_sample,
    store_of,
)

STRICT = ("-Wall", "-Wextra", "-Werror", "-Wconversion", "-pedantic")
SANITIZERS = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
DRIVER_SOURCE = Path(__file__).parent / "board_driver.c"
_INIT, _RECEIVE, _SAMPLE, _STEP, _PERSISTENT, _RESTART, _PAIR = range(7)
_LONGEST_REQUEST = 1024
_CONFIG = struct.Struct("<QBBBHHhHHHB")


def compile_driver(target: Path) -> Path:
    """The driver program, with the sanitizers."""
    return compile_board(target, str(DRIVER_SOURCE), *STRICT, *SANITIZERS)


class Driver:
    """The driver program as a process; it holds one board at a time."""

    def __init__(self, program: Path) -> None:
        self._process = subprocess.Popen(
            [str(program)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )

    def call(self, operation: int, now_ms: int, body: bytes = b"") -> bytes:
        """One operation's answer. Raises AssertionError with the sanitizers' report when it is dead."""
        process = self._process
        assert process.stdin is not None and process.stdout is not None and process.stderr is not None
        process.stdin.write(struct.pack("<BIH", operation, now_ms & 0xFFFFFFFF, len(body)) + body)
        process.stdin.flush()
        size = process.stdout.read(2)
        if len(size) < 2:
            raise AssertionError(process.stderr.read().decode(errors="replace"))
        return process.stdout.read(int.from_bytes(size, "little"))

    def close(self) -> str:
        """Ends the process; returns what the sanitizers said."""
        _, errors = self._process.communicate()
        return errors.decode(errors="replace")


class SanitizedBoard:
    """The board in the driver's process behind the calls of BoardCore."""

    def __init__(
        self, driver: Driver, config: BoardConfig, persistent: bytes, reset_cause: int, boot_count: int
    ) -> None:
        self._driver = driver
        body = _CONFIG.pack(*raw_config(config)) + store_of(persistent)
        self._waiting = driver.call(_INIT, 0, body + struct.pack("<BI", reset_cause, boot_count))

    def receive(self, data: bytes, now_ms: int) -> None:
        for start in range(0, len(data), _LONGEST_REQUEST):
            self._waiting += self._driver.call(_RECEIVE, now_ms, data[start : start + _LONGEST_REQUEST])

    def sample(self, samples, now_ms: int) -> None:
        for signal, (value, quality) in samples.items():
            body = struct.pack("<BBi", SIGNALS.index(signal), raw_quality(quality), raw_sample(signal, value))
            self._driver.call(_SAMPLE, now_ms, body)

    def step(self, now_ms: int) -> Pins:
        answer = self._driver.call(_STEP, now_ms)
        self._waiting += answer[5:]
        heater, fan, led_pct, valve, cutoff = answer[:5]
        return Pins(bool(heater), bool(fan), led_pct / 100, bool(valve), bool(cutoff))

    def transmit(self) -> bytes:
        waiting, self._waiting = self._waiting, b""
        return waiting

    def persistent(self) -> bytes:
        return self._driver.call(_PERSISTENT, 0)

    def sample_pair(self, first_c: float | None, second_c: float | None, verdict: int) -> None:
        raws = [raw_sample("temp_air_c", value) for value in (first_c, second_c)]
        self._driver.call(_PAIR, 0, struct.pack("<iiB", *raws, verdict))

    @property
    def restart(self) -> bool:
        return self._driver.call(_RESTART, 0) == b"\1"


def python_board(config: BoardConfig, persistent: bytes, reset_cause: int, boot_count: int) -> BoardCore:
    """The Python board with a blank block and three parts on its wire, as the driver's."""
    return BoardCore(
        config, persistent, reset_cause, boot_count, BlockSlots(BoardKind.UNO, roms=(0x28, 0x128, 0x228))
    )
