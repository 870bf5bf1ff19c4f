"""The C drivers as a shared library, and buses whose other end is Python: a test simulates the parts."""

import ctypes
import functools
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import pytest

from tests.support.builds import built
from tests.support.c_core import SOURCES

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
    """All drivers; undefined behaviour ends the process."""
    if shutil.which("gcc") is None:
        pytest.fail("gcc is missing: `make test` installs it")
    return ctypes.CDLL(str(built("drivers.so", compile_drivers, SOURCES.rglob("gh_*"))))


def compile_drivers(target: Path) -> None:
    sources = sorted(map(str, [*SOURCES.glob("gh_*.c"), *DRIVERS.glob("*.c")]))
    flags = ["-std=c11", "-O1", "-g", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-pedantic", "-fPIC"]
    flags += ["-shared", "-fsanitize=undefined", "-fno-sanitize-recover=all"]
    flags += ["-I", str(SOURCES), "-I", str(DRIVERS)]
    subprocess.run(["gcc", *flags, *sources, "-o", str(target)], check=True)


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


class OneWirePart(Protocol):
    """A part on a simulated 1-Wire bus, slot by slot."""

    def reset(self, now_us: float) -> bool:
        """Take a reset pulse. Returns : whether the part answers with a presence pulse"""

    def level(self, now_us: float) -> bool:
        """False while the part pulls the line low in the coming slot."""

    def see(self, level: bool, now_us: float) -> None:
        """Take the line's level in the slot."""


class SimulatedOneWire:
    """A 1-Wire bus. now_ms : set by the test; spent_us : bus time since it was last set to 0"""

    def __init__(self, *parts: OneWirePart) -> None:
        self.parts = list(parts)
        self.now_ms = 0.0
        self.spent_us = 0.0
        self.result: int | None = None  # what every reset ends with
        self.disturb: Callable[[bool], bool] = bool  # what the board reads instead of the line's level
        self.bus = OneWire(None, RESET(self._reset), SLOT(self._slot))

    @property
    def now_us(self) -> float:
        """Time of the simulated parts."""
        return self.now_ms * 1000.0 + self.spent_us

    def _reset(self, _context) -> int:
        self.spent_us += RESET_US
        if self.result is not None:
            return self.result
        return OK if any([part.reset(self.now_us) for part in self.parts]) else SILENT

    def _slot(self, _context, bit) -> bool:
        self.spent_us += SLOT_US
        level = bit and all([part.level(self.now_us) for part in self.parts])
        for part in self.parts:
            part.see(level, self.now_us)
        return self.disturb(level)


class LinePart(Protocol):
    """A part on single pins."""

    def driven(self, pin: int, level: int, now_us: float) -> None:
        """Take what the board does to a pin."""

    def pulsed(self, pin: int, high_us: int, now_us: float) -> None:
        """Take a pulse of the board."""

    def level(self, pin: int, now_us: float) -> bool | None:
        """Level that the part gives to the pin, None when it leaves it alone."""

    def highs(self, pin: int) -> list[tuple[float, float]]:
        """Begin and end of each high level, past and planned."""


class SimulatedLines:
    """The pins of the board. now_ms : set by the test; spent_us : time in calls since it was last set to 0"""

    def __init__(self, *parts: LinePart) -> None:
        self.parts = list(parts)
        self.now_ms = 0.0
        self.spent_us = 0.0
        self.counts: Callable[[int], int] = lambda _channel: 0
        self.levels: dict[int, int] = {}  # as the board drives them
        self.listened: tuple[int, float] | None = None
        self.bus = Lines(
            None,
            DRIVE(self._drive),
            IS_HIGH(self._is_high),
            PULSE(self._pulse),
            LISTEN(self._listen),
            HEARD(self._heard),
            ANALOG(self._analog),
        )

    @property
    def now_us(self) -> float:
        """Time of the simulated parts."""
        return self.now_ms * 1000.0 + self.spent_us

    def _drive(self, _context, pin, level) -> None:
        self.spent_us += 2.0
        self.levels[pin] = level
        for part in self.parts:
            part.driven(pin, level, self.now_us)

    def _is_high(self, _context, pin) -> bool:
        self.spent_us += 2.0
        if self.levels.get(pin, RELEASED) != RELEASED:
            return self.levels[pin] == HIGH
        return all(part.level(pin, self.now_us) in (True, None) for part in self.parts)

    def _pulse(self, _context, pin, high_us) -> None:
        self.spent_us += high_us
        for part in self.parts:
            part.pulsed(pin, high_us, self.now_us)

    def _listen(self, _context, pin) -> None:
        self.spent_us += 5.0
        self.listened = (pin, self.now_us)

    def _heard(self, _context, high_us, size) -> int:
        self.spent_us += 50.0
        pin, since = self.listened or (0, 0.0)
        highs = sorted(high for part in self.parts for high in part.highs(pin))
        lengths = [min(end - start, 65535.0) for start, end in highs if start >= since and end <= self.now_us]
        for i, length in enumerate(lengths[:size]):
            high_us[i] = round(length)
        return min(len(lengths), 255)

    def _analog(self, _context, channel) -> int:
        self.spent_us += 110.0
        return self.counts(channel)


class CDriver:
    """One driver's structure, called step by step.

    name : `gh_x`; bus : simulated, its time is set here and each step's is held to STEP_MAX_US
    start_ms : time at the first step; the driver gets it in 32 bits, which wrap
    """

    def __init__(self, name: str, bus: SimulatedOneWire | SimulatedLines | None, start_ms: int = 0) -> None:
        self.name = name
        self.bus = bus
        self.now_ms = start_ms
        self.late_ms = 0.0  # how old the time is that the driver gets
        self.memory = (ctypes.c_uint64 * 32)()  # more than any driver has
        self._end = 0x5AFE5AFE5AFE5AFE
        self.memory[-1] = self._end
        self._step = getattr(drivers(), f"{name}_step")
        self._step.restype = ctypes.c_bool
        self._moved()

    def _moved(self) -> None:
        if self.bus is not None:
            self.bus.now_ms, self.bus.spent_us = self.now_ms + self.late_ms, 0.0

    def init(self, *arguments) -> None:
        """Call gh_x_init."""
        getattr(drivers(), f"{self.name}_init")(self.memory, *arguments)

    def clock(self) -> ctypes.c_uint32:
        """Milliseconds of the board, as a driver gets them."""
        return U32(self.now_ms & 0xFFFFFFFF)

    def step(self, *arguments) -> bool:
        """Call gh_x_step. Returns : whether it told something"""
        self._moved()
        said = self._step(self.memory, self.clock(), *arguments)
        assert self.memory[-1] == self._end
        if self.bus is not None:
            assert self.bus.spent_us <= STEP_MAX_US
        return said
