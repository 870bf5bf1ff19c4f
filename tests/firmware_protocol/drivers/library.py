"""The C drivers as a shared library, and buses whose other end is Python: a test simulates the parts."""

import ctypes
import functools
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from firmware_protocol.virtual_board.c_core import SOURCES

DRIVERS = SOURCES / "drivers"
OK, SILENT, STUCK, SLOW = range(4)
LOW, HIGH, RELEASED = range(3)
NO_VALUE = -(2**31)
GOOD, STALE, RANGE, FAULT, ABSENT = range(5)
STEP_MAX_US = 2000.0  # no step of a driver may take longer on its bus
BYTE_US, START_US = 90.0, 20.0  # I2C at 100 kHz
RESET_US, SLOT_US = 1000.0, 70.0  # 1-Wire
U8, U16, U32 = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32
BYTES = ctypes.POINTER(U8)
TRANSFER = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, U8, BYTES, U8, BYTES, U8)
RESET = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
SLOT = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_bool)
DRIVE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, U8, ctypes.c_int)
IS_HIGH = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, U8)
PULSE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, U8, U8)
LISTEN = ctypes.CFUNCTYPE(None, ctypes.c_void_p, U8)
HEARD = ctypes.CFUNCTYPE(U8, ctypes.c_void_p, ctypes.POINTER(U16), U8)
ANALOG = ctypes.CFUNCTYPE(U16, ctypes.c_void_p, U8)


class I2c(ctypes.Structure):
    """gh_i2c"""

    _fields_ = (("context", ctypes.c_void_p), ("transfer", TRANSFER))


class OneWire(ctypes.Structure):
    """gh_one_wire"""

    _fields_ = (("context", ctypes.c_void_p), ("reset", RESET), ("slot", SLOT))


class Lines(ctypes.Structure):
    """gh_lines"""

    _fields_ = (
        ("context", ctypes.c_void_p),
        ("drive", DRIVE),
        ("is_high", IS_HIGH),
        ("pulse", PULSE),
        ("listen", LISTEN),
        ("heard", HEARD),
        ("analog", ANALOG),
    )


class Measurement(ctypes.Structure):
    """gh_measurement"""

    _fields_ = (("raw", ctypes.c_int32), ("quality", U8))

    @property
    def value(self) -> tuple[int | None, int]:
        """Raw integer, None where there is no number, and the quality."""
        return (None if self.raw == NO_VALUE else self.raw, self.quality)


@functools.cache
def drivers() -> ctypes.CDLL:
    """All drivers, compiled once a process, undefined behaviour ends it."""
    if shutil.which("gcc") is None:
        pytest.fail("gcc is missing: `make test` installs it")
    sources = sorted(map(str, DRIVERS.glob("*.c")))
    flags = ["-std=c11", "-O1", "-g", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-pedantic", "-fPIC"]
    flags += ["-shared", "-fsanitize=undefined", "-fno-sanitize-recover=all"]
    flags += ["-I", str(SOURCES), "-I", str(DRIVERS)]
    with tempfile.TemporaryDirectory(prefix="greenhouse-drivers-") as folder:  # may go once it is mapped
        target = Path(folder) / "drivers.so"
        subprocess.run(["gcc", *flags, *sources, "-o", str(target)], check=True)
        return ctypes.CDLL(str(target))


class SimulatedI2c:
    """An I2C bus with simulated slaves by address. spent_us : bus time since it was last set to 0"""

    def __init__(self, slaves: dict[int, object]) -> None:
        self.slaves = slaves
        self.result: int | None = None  # what every transfer ends with, instead of asking the slave
        self.spent_us = 0.0
        self.bus = I2c(None, TRANSFER(self._transfer))

    def _transfer(self, _context, address, out, out_size, into, in_size) -> int:
        written = bytes(out[i] for i in range(out_size))
        self.spent_us += START_US * 2 + BYTE_US * (2 + out_size + in_size)
        if self.result is not None:
            return self.result
        slave = self.slaves.get(address)
        answer = None if slave is None else slave.exchange(written, in_size)
        if answer is None:
            return SILENT
        for i, byte in enumerate(answer[:in_size]):
            into[i] = byte
        return OK


def crc8(data: Sequence[int], polynomial: int = 0x31, start: int = 0xFF) -> int:
    """CRC-8 of Sensirion's parts: check value of b"123456789" is 0xF7 (CRC-8/NRSC-5)."""
    crc = start
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = ((crc << 1) ^ polynomial if crc & 0x80 else crc << 1) & 0xFF
    return crc
