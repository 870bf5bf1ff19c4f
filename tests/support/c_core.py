"""The board of `firmware_protocol/c`, with the same calls as `core.BoardCore`. Needs a C compiler.

python -m firmware_protocol.virtual_board --core tests.support.c_core:boots ...
"""

import ctypes
import functools
import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import firmware_protocol
from firmware_protocol.messages import LAYOUTS, Hello, ResetCause
from firmware_protocol.virtual_board import board_samples
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.board_outputs import Pins
from firmware_protocol.virtual_board.board_samples import to_raw
from firmware_protocol.virtual_board.device import Boot, Core
from tests.support.builds import built

SOURCES = Path(firmware_protocol.__file__).parent / "c"
SIGNALS = tuple(board_samples.SIGNALS)  # in the order of gh_signal
BLANK = b"\xff\xff\xff\xff"  # a store that holds no trip
_TRANSMIT_SIZE = 192
_NO_VALUE = -(2**31)
_FIELDS = {field.name: field for field in LAYOUTS[Hello].fields}
_U8, _U16, _I16 = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_int16
_U32, _U64 = ctypes.c_uint32, ctypes.c_uint64


class CompilerMissing(RuntimeError):
    """The C board was asked for where nothing can compile it."""


class CConfig(ctypes.Structure):
    """gh_board_config; the names are those of the hello message, which carries the same integers."""

    _fields_ = (
        ("board_id", _U64),
        ("firmware_major", _U8),
        ("firmware_minor", _U8),
        ("firmware_patch", _U8),
        ("capabilities", _U16),
        ("lease_max_s", _U16),
        ("temp_trip_c", _I16),
        ("valve_pulse_max_s", _U16),
        ("pwm_window_s", _U16),
        ("report_period_s", _U16),
        ("fan_safe_on", ctypes.c_bool),
    )


class CPins(ctypes.Structure):
    """gh_pins"""

    _fields_ = (
        ("heater_relay", ctypes.c_bool),
        ("fan", ctypes.c_bool),
        ("led_pct", _U8),
        ("valve", ctypes.c_bool),
        ("cutoff_open", ctypes.c_bool),
    )


def compile_board(target: Path, *arguments: str) -> Path:
    """Compiles every C source of the board, with further compiler arguments, to `target` and returns it.

    Raises CompilerMissing where there is no compiler, CalledProcessError where it refuses the sources.
    """
    compiler = os.environ.get("CC", "gcc")
    if shutil.which(compiler) is None:
        raise CompilerMissing(
            f"the C board needs a C compiler; {compiler!r} is missing: install gcc or set CC"
        )
    sources = sorted(str(path) for path in SOURCES.glob("gh_*.c"))
    command = [compiler, "-std=c11", "-I", str(SOURCES), *sources, *arguments, "-o", str(target)]
    subprocess.run(command, check=True)
    return target


@functools.cache
def load_board() -> ctypes.CDLL:
    """Return the C board as a shared library."""
    library = ctypes.CDLL(str(built("board.so", _compile_library, SOURCES.glob("gh_*"))))
    board, out = ctypes.c_void_p, ctypes.c_char_p
    library.gh_board_size.restype = ctypes.c_size_t
    library.gh_board_init.argtypes = (board, ctypes.POINTER(CConfig), ctypes.c_char_p, _U8, _U32)
    library.gh_board_receive.argtypes = (board, _U8, _U32)
    library.gh_board_sample.argtypes = (board, ctypes.c_int, ctypes.c_int32, _U8, _U32)
    library.gh_board_step.argtypes = (board, _U32)
    library.gh_board_step.restype = CPins
    library.gh_board_transmit.argtypes = (board, out, ctypes.c_size_t)
    library.gh_board_transmit.restype = ctypes.c_size_t
    library.gh_board_persistent.argtypes = (board, out)
    return library


def _compile_library(target: Path) -> None:
    compile_board(target, "-O2", "-fPIC", "-shared")


def raw_config(config: BoardConfig) -> tuple[int, ...]:
    """Return the fields of gh_board_config, in their order, as the integers that travel in hello."""
    hello = config.hello(session=0, reset_cause=ResetCause.UNKNOWN, boot_count=0)
    return tuple(_FIELDS[name].to_raw(getattr(hello, name)) for name, _ in CConfig._fields_)


def raw_sample(signal: str, value: float | None) -> int:
    """Return a sample as gh_board_sample takes it."""
    raw = to_raw(signal, value)
    return _NO_VALUE if raw is None else raw


def raw_quality(quality: int) -> int:
    """Return a quality as gh_board_sample takes it; an invalid one stays invalid."""
    return quality if 0 <= quality <= 255 else 255


def store_of(persistent: bytes) -> bytes:
    """Return the four bytes of a store as gh_board_init takes them; another length is a damaged store."""
    if not persistent:
        return BLANK
    return persistent if len(persistent) == len(BLANK) else bytes(len(BLANK))


class CBoardCore:
    """The C board behind the calls of `core.BoardCore`."""

    def __init__(self, config: BoardConfig, persistent: bytes, reset_cause: int, boot_count: int) -> None:
        self._library = load_board()
        self._board = (_U64 * (self._library.gh_board_size() // 8 + 1))()
        self._library.gh_board_init(
            self._board, CConfig(*raw_config(config)), store_of(persistent), reset_cause, boot_count
        )
        self._waiting = bytearray()
        self._drain()

    def receive(self, data: bytes, now_ms: int) -> None:
        """Bytes from the line."""
        for byte in data:
            self._library.gh_board_receive(self._board, byte, now_ms)
            if byte == 0:  # only the end of a frame is answered
                self._drain()

    def sample(self, samples: Mapping[str, tuple[float | None, int]], now_ms: int) -> None:
        """Take new samples: signal -> (value in its unit or None, Quality)."""
        for signal, (value, quality) in samples.items():
            number, raw = SIGNALS.index(signal), raw_sample(signal, value)
            self._library.gh_board_sample(self._board, number, raw, raw_quality(quality), now_ms)

    def step(self, now_ms: int) -> Pins:
        """Advance and return the new outputs; to be called at least every 100 ms."""
        pins = self._library.gh_board_step(self._board, now_ms)
        self._drain()
        return Pins(pins.heater_relay, pins.fan, pins.led_pct / 100, pins.valve, pins.cutoff_open)

    def transmit(self) -> bytes:
        """Return the bytes for the line since the last call."""
        data = bytes(self._waiting)
        self._waiting.clear()
        return data

    def persistent(self) -> bytes:
        """Return the bytes that must survive a reset, to be stored when they change."""
        out = ctypes.create_string_buffer(len(BLANK))
        self._library.gh_board_persistent(self._board, out)
        return out.raw

    def _drain(self) -> None:
        """Empty the board's own buffer, as a UART would meanwhile: bytes that find it full are lost."""
        out = ctypes.create_string_buffer(_TRANSMIT_SIZE)
        length = self._library.gh_board_transmit(self._board, out, _TRANSMIT_SIZE)
        self._waiting += out.raw[:length]


def boots(config: BoardConfig) -> Boot:
    """Return the starts of one board, as the virtual board's `--core` takes them."""

    def boot(persistent: bytes, cause: ResetCause, boot_count: int) -> Core:
        return CBoardCore(config, persistent, cause, boot_count)

    return boot
