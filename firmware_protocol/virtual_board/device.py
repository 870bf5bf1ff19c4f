"""The board as a thing: its firmware, the box it feels and heats, its store, and the faults in them."""

from collections.abc import Callable, Mapping
from typing import Protocol

from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.messages import LAYOUTS, ErrorCode, ErrorMessage, Hello, ResetCause, read_header
from firmware_protocol.virtual_board.core import Pins
from firmware_protocol.virtual_board.faults import BoardFault, Schedule
from firmware_protocol.virtual_board.plant import Plant
from firmware_protocol.virtual_board.port import FaultyLine
from firmware_protocol.virtual_board.sensors import Sample, SensorFaults
from firmware_protocol.virtual_board.store import Eeprom

_HELLO, _ERROR = LAYOUTS[Hello].kind, LAYOUTS[ErrorMessage].kind
_VERSION, _BODY = 0, 4  # where a payload has its version, and its body
_SESSION_LENGTH = 4  # of hello; protocol_min and protocol_max follow


class OtherProtocol:
    """Stands between the line and the firmware."""

    def __init__(self, version: int) -> None:
        self.version = version
        self._from_host = FrameDecoder()
        self._from_firmware = FrameDecoder()

    def to_firmware(self, data: bytes) -> bytes:
        """Translate a host's bytes of another version for this board."""
        return b"".join(self._frame(bytearray(payload)) for payload in self._from_host.feed(data))

    def to_host(self, data: bytes) -> bytes:
        """Translate this board's bytes, which carry another version."""
        frames = b""
        for received in self._from_firmware.feed(data):
            payload = bytearray(received)
            kind = read_header(received).kind
            if kind == _HELLO:
                first = _BODY + _SESSION_LENGTH
                payload[first : first + 2] = bytes([self.version] * 2)
            elif kind == _ERROR and payload[_BODY] == ErrorCode.VERSION:
                payload[_BODY + 1] = self.version
            frames += self._frame(payload)
        return frames

    def _frame(self, payload: bytearray) -> bytes:
        payload[_VERSION] = self.version
        return encode(bytes(payload))


WRAP_MS = 1 << 32


class BoardClock:
    """Maps simulated time to board_ms."""

    def __init__(self, now_ms: int) -> None:
        self._since_ms = now_ms
        self._board_ms = 0.0
        self._factor = 1.0

    def read(self, now_ms: int) -> int:
        """board_ms, 0 .. 2^32 - 1."""
        return int(self._board_ms + (now_ms - self._since_ms) * self._factor) % WRAP_MS

    def set_factor(self, factor: float, now_ms: int) -> None:
        """Run this much faster than time from now on."""
        if factor != self._factor:
            self._board_ms += (now_ms - self._since_ms) * self._factor
            self._since_ms, self._factor = now_ms, factor

    def set_before_wrap(self, before_s: float, now_ms: int) -> None:
        """Jump to this long before the wrap."""
        self._since_ms, self._board_ms = now_ms, WRAP_MS - before_s * 1000.0


STEP_MS = 100  # firmware runs at least this often
TURNAROUND_MS = 5  # a request of 30 bytes takes 3 ms at 115200 baud, then the firmware answers
SAMPLE_MS = 1000  # sensors are read this often


class Core(Protocol):
    """The firmware: `core.BoardCore`, or the C one. All `now_ms` are the board's clock, which wraps."""

    def receive(self, data: bytes, now_ms: int) -> None:
        """Take bytes of the line; the answer to a whole frame waits for `transmit`."""
        ...

    def sample(self, samples: Mapping[str, Sample], now_ms: int) -> None:
        """Take new samples: signal -> (value in its unit or None, quality)."""
        ...

    def step(self, now_ms: int) -> Pins:
        """Let leases, slots and reports pass to `now_ms` and return the pins; due every `STEP_MS`."""
        ...

    def transmit(self) -> bytes:
        """Return the bytes for the line since the last call."""
        ...

    def persistent(self) -> bytes:
        """Return the latches with their checksum, 4 bytes, for the next boot."""
        ...


Boot = Callable[[bytes, ResetCause, int], Core]  # persistent bytes, cause, boot count -> running firmware


class Device:
    """Moves in steps from one simulated millisecond to a later one; bytes go in and out between steps."""

    def __init__(self, boot: Boot, plant: Plant, store: Eeprom, faults: list[BoardFault]) -> None:
        self.now_ms = 0
        self.boots: list[tuple[float, ResetCause]] = []
        self.plant = plant
        self.to_board = FaultyLine("to_board")
        self.to_host = FaultyLine("to_host")
        self.schedule = Schedule([])
        self._boot, self._store = boot, store
        self._sensors = SensorFaults()
        self._clock = BoardClock(0)
        self._translator: OtherProtocol | None = None
        self._core: Core | None = None
        self._resets_due: list[tuple[int, ResetCause, int]] = []  # reset at, cause, boot time [ms]
        self._boots_at_ms = 0
        self._boots_from = ResetCause.POWER_ON
        self._sample_at_ms = 0
        self._turnaround_at_ms = float("inf")
        for fault in faults:
            self.schedule.add(fault)
        self._work()

    @property
    def unplugged(self) -> bool:
        """A fault has pulled the plug."""
        return any(fault.name == "unplug" for fault in self.schedule.active)

    @property
    def boot_count(self) -> int:
        """Boots since the store was blank."""
        return self._store.boot_count

    def receive(self, data: bytes) -> None:
        """Bytes from the host, now."""
        self.to_board.send(data, self.now_ms)
        if self.to_board.next_arrival_ms <= self.now_ms:
            self._turnaround_at_ms = self.now_ms + TURNAROUND_MS
            self._take_host_bytes()

    def transmit(self) -> bytes:
        """Bytes that have arrived at the host by now."""
        return self.to_host.arrive(self.now_ms)

    def inject(self, fault: BoardFault) -> None:
        """One more fault; it begins now or later."""
        self.schedule.add(fault)
        if fault.start_ms <= self.now_ms:
            self._change_faults()

    def clear_faults(self) -> None:
        """End all faults that last or wait."""
        self.schedule.clear()
        self._resets_due.clear()
        self._change_faults()

    @property
    def next_step_ms(self) -> int:
        """When something can happen next; always later than now."""
        due = min(
            (self.now_ms // STEP_MS + 1) * STEP_MS,
            self._turnaround_at_ms,
            self.schedule.next_change_ms,
            self.to_board.next_arrival_ms,
            self.to_host.next_arrival_ms,
        )
        return max(int(due), self.now_ms + 1)

    def step(self, until_ms: int) -> None:
        """Let time pass to the next thing that can happen, or to `until_ms`."""
        self.now_ms = min(self.next_step_ms, until_ms)
        self._work()

    def _work(self) -> None:
        now_ms = self.now_ms
        if self._core is None and now_ms >= self._boots_at_ms:
            self._start_firmware()
        if now_ms >= self.schedule.next_change_ms:
            self._change_faults()
        if now_ms >= self._turnaround_at_ms:
            self._turnaround_at_ms = float("inf")
        if self._resets_due and now_ms >= self._resets_due[0][0]:
            self._reset(*self._resets_due.pop(0)[1:])
        if now_ms >= self._sample_at_ms:
            self._take_samples()
        self._take_host_bytes()
        if self._core is not None:
            self.plant.drive(self._core.step(self._clock.read(now_ms)), now_ms)
            self._send_host_bytes(self._core.transmit())
            self._store.keep(self._core.persistent())

    def _take_samples(self) -> None:
        self._sample_at_ms = (self.now_ms // SAMPLE_MS + 1) * SAMPLE_MS
        samples = self._sensors.spoil(self.plant.sense(self.now_ms))
        if self._core is not None:
            self._core.sample(samples, self._clock.read(self.now_ms))

    def _take_host_bytes(self) -> None:
        data = self.to_board.arrive(self.now_ms)
        if self._translator is not None:
            data = self._translator.to_firmware(data)
        if data and self._core is not None:  # a booting board hears nothing
            self._core.receive(data, self._clock.read(self.now_ms))

    def _send_host_bytes(self, data: bytes) -> None:
        if self._translator is not None:
            data = self._translator.to_host(data)
        if data:
            self.to_host.send(data, self.now_ms)

    def _start_firmware(self) -> None:
        self._clock = BoardClock(self.now_ms)
        self._store.count_boot()
        self._core = self._boot(self._store.persistent, self._boots_from, self._store.boot_count)
        self.boots.append((self.now_ms / 1000, self._boots_from))
        self._set_clock_rate()

    def _reset(self, cause: ResetCause, boot_time_ms: int) -> None:
        self._core = None
        self._boots_from = cause
        self._boots_at_ms = self.now_ms + boot_time_ms
        self.plant.let_go(self.now_ms)

    def _change_faults(self) -> None:
        begun = self.schedule.pass_to(self.now_ms)
        active = self.schedule.active
        self.to_board.set_faults(active)
        self.to_host.set_faults(active)
        self._sensors.set_faults(active)
        self.plant.set_faults({fault.name for fault in active}, self.now_ms)
        self._set_clock_rate()
        self._set_protocol()
        if self.unplugged:
            self.to_board.cut()
            self.to_host.cut()
        for fault in begun:
            self._begin(fault)

    def _set_clock_rate(self) -> None:
        factor = 1.0
        for fault in self.schedule.active:
            if fault.name == "clock_drift":
                factor *= fault.number("factor")
        self._clock.set_factor(factor, self.now_ms)

    def _set_protocol(self) -> None:
        version = None
        for fault in self.schedule.active:
            if fault.name == "other_protocol":
                version = int(fault.number("version"))
        if version is None:
            self._translator = None
        elif self._translator is None or self._translator.version != version:
            self._translator = OtherProtocol(version)

    def _begin(self, fault: BoardFault) -> None:
        match fault.name:
            case "garbage":
                self.to_board.garbage(fault, self.now_ms)
                self.to_host.garbage(fault, self.now_ms)
            case "clock_wrap":
                self._clock.set_before_wrap(fault.number("before_s"), self.now_ms)
            case "reset":
                self._plan_resets(ResetCause[str(fault.parameters["cause"]).upper()], fault, 1, 0.0)
            case "brown_out":
                count, period_s = int(fault.number("count")), fault.number("period_s")
                self._plan_resets(ResetCause.BROWN_OUT, fault, count, period_s)

    def _plan_resets(self, cause: ResetCause, fault: BoardFault, count: int, period_s: float) -> None:
        boot_time_ms = round(fault.number("boot_time_s") * 1000)
        times = [fault.start_ms + round(number * period_s * 1000) for number in range(count)]
        self._resets_due += [(time, cause, boot_time_ms) for time in times]
        self._resets_due.sort()
