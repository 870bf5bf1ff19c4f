"""The board's program on a simulated microcontroller, and the host's link at the other end of its line."""

import struct
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from firmware_protocol.link import Link
from firmware_protocol.messages import Message

FREQUENCY = 16_000_000
MEGA2560, UNO = "atmega2560", "atmega328p"
RAM_END = {MEGA2560: 0x21FF, UNO: 0x08FF}
FLASH = {MEGA2560: 262_144, UNO: 32_768}
PORTA, OCR4A, TCCR4A = 0x22, 0xA8, 0xA0
COM4A1 = 0x80
HEATER, FAN, VALVE, SUPPLY = 1, 2, 4, 8
STEP_MS = 10
_QUESTION = 1 << 31
_EVENT = struct.Struct("<QBBB")
_MEASURED = struct.Struct("<IIQ")
_FUNCTION = struct.Struct("<IIQQQI4x")


@dataclass(frozen=True)
class AvrEvent:
    """An event of the program: T(ransmitted byte), P(ORTx), D(DRx), E(EPROM byte begun), R(eset), C(rash).

    port : letter of P and D
    """

    cycle: int
    kind: str
    port: str
    value: int


@dataclass(frozen=True)
class Timing:
    """The time of one function, interrupts included [cycles]."""

    calls: int
    total: int
    longest: int

    @property
    def mean(self) -> float:
        return self.total / self.calls


@dataclass(frozen=True)
class Measured:
    """Since the power came."""

    stack_bytes: int
    lost_bytes: int  # by the UART, because nobody fetched them in time
    longest_without_interrupts: int  # [cycles]
    functions: dict[str, Timing]


class PartsOutside(Protocol):
    """Parts on the pins of the microcontroller. Times are its cycles since the power came."""

    def level_changed(self, cycle: int, port: str, bit: int, level: int) -> bytes:
        """Take what it does to a watched pin: LOW, HIGH, RELEASED. Returns : levels to come"""

    def i2c_called(self, cycle: int, address: int, reading: bool) -> bytes | None:
        """Return what is read, None where nobody acknowledges."""

    def i2c_written(self, cycle: int, address: int, data: bytes) -> None:
        """Take the bytes of a transfer that has ended."""


class SimulatedAvr:
    """One microcontroller with its power on. `eeprom` None is a new one."""

    def __init__(
        self,
        host: Path,
        program: Path,
        eeprom: bytes | None = None,
        microcontroller: str = MEGA2560,
        parts: PartsOutside | None = None,
        bootloader: Path | None = None,
    ) -> None:
        is_hex = program.suffix == ".hex"
        self._folder = tempfile.TemporaryDirectory(prefix="avr-")
        reset_address = 0
        if is_hex:
            image = Path(self._folder.name) / "flash.bin"
            reset_address = write_image(image, FLASH[microcontroller], program, bootloader)
            program = image
        command, pipe = [str(host), microcontroller, str(program), str(reset_address)], subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)
        self._symbols = {} if is_hex else _symbols(program)
        self._ram_end = RAM_END[microcontroller]
        self._parts = parts
        self._timed: list[str] = []
        self.cycle = 0
        if eeprom is not None:
            self._call("p", 0, eeprom)

    def __enter__(self) -> "SimulatedAvr":
        return self

    def __exit__(self, *_: object) -> None:
        """The power fails."""
        self._process.kill()
        self._process.communicate()
        self._folder.cleanup()

    @property
    def now(self) -> float:
        """Since the power came [s]."""
        return self.cycle / FREQUENCY

    def run(self, milliseconds: float, data: bytes = b"") -> list[AvrEvent]:
        """Run for that time while bytes come in, and return the events."""
        answer = self._call("a", round(milliseconds * FREQUENCY / 1000), data)
        [self.cycle] = struct.unpack_from("<Q", answer)
        events = _EVENT.iter_unpack(answer[8:])
        return [AvrEvent(cycle, chr(kind), chr(port), value) for cycle, kind, port, value in events]

    def watch(self, pins: dict[str, int]) -> None:
        """Tell the parts outside of these pins from now on. pins : masks by port letter"""
        self._call("b", 0, b"".join(bytes((ord(port), mask)) for port, mask in pins.items()))

    def connect_i2c(self) -> None:
        """Tell the parts outside of the I2C bus from now on."""
        self._call("t")

    def set_level(self, port: str, bit: int, level: int) -> None:
        """Set the level of a pin from outside."""
        self._call("i", 0, bytes((ord(port), bit, level)))

    def set_millivolts(self, channel: int, millivolts: int) -> None:
        """Set the voltage of an analog channel; the supply is 5000 mV."""
        self._call("v", channel, struct.pack("<H", millivolts))

    def read(self, address: int, length: int = 1) -> bytes:
        """Read data memory and input/output registers."""
        return self._call("r", address, struct.pack("<H", length))

    def write(self, symbol: str, data: bytes) -> None:
        """Sets a variable of the program."""
        self._call("w", self._symbols[symbol] & 0xFFFF, data)

    def eeprom(self) -> bytes:
        return self._call("g")

    def reset(self) -> None:
        """By the reset pin."""
        self._call("x")

    def time_function(self, name: str) -> None:
        """From now on."""
        self._timed.append(name)
        self._call("f", self._symbols[name])

    def measured(self) -> Measured:
        answer = self._call("m")
        stack, lost, off = _MEASURED.unpack_from(answer)
        rows = _FUNCTION.iter_unpack(answer[_MEASURED.size :])
        timings = [Timing(calls, total, longest) for _, calls, _, total, longest, _ in rows]
        return Measured(self._ram_end - stack, lost, off, dict(zip(self._timed, timings, strict=True)))

    def _call(self, operation: str, argument: int = 0, data: bytes = b"") -> bytes:
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(struct.pack("<BIH", ord(operation), argument, len(data)) + data)
        process.stdin.flush()
        while True:
            head = process.stdout.read(4)
            assert len(head) == 4, "the simulator is dead"
            size = int.from_bytes(head, "little")
            said = process.stdout.read(size & ~_QUESTION)
            if not size & _QUESTION:
                return said
            reply = self._reply(said)
            process.stdin.write(struct.pack("<H", len(reply)) + reply)
            process.stdin.flush()

    def _reply(self, question: bytes) -> bytes:
        """Return what the parts outside say to a question of the program, see avr_host.c."""
        assert self._parts is not None
        cycle, told = int.from_bytes(question[1:9], "little"), question[9:]
        match chr(question[0]):
            case "L":
                return self._parts.level_changed(cycle, chr(told[0]), told[1], told[2])
            case "A":
                read = self._parts.i2c_called(cycle, told[0], bool(told[1]))
                return b"\0" if read is None else b"\1" + read
            case _:
                self._parts.i2c_written(cycle, told[0], told[1:])
                return b""


class AvrRig:
    """The microcontroller, its sensor unless the program has none, and the host's own link."""

    def __init__(self, avr: SimulatedAvr, has_sensor: bool = True) -> None:
        self.avr = avr
        self.link = Link(session=1, now=avr.now)
        self.events: list = []
        self.trace: list[AvrEvent] = []
        if has_sensor:
            self.sense(25.0)
            self.fail(0)

    def sense(self, air_c: float | None) -> None:
        """Set the air sensor's value from now on; None for one that does not answer."""
        raw = -(2**31) if air_c is None else round(air_c * 100)
        self.avr.write("rig_air", struct.pack("<i", raw))
        self.avr.write("rig_quality", bytes((3 if air_c is None else 0,)))

    def fail(self, fault: int) -> None:
        """A fault of avr/sensors.c from the program's next look at the sensors on; 0 for none."""
        self.avr.write("rig_fault", bytes((fault,)))

    def run(self, seconds: float, until=lambda rig: False) -> list[tuple[float, int, int]]:
        """Serves the line; returns time [s], PORTA and LED [%] of every step."""
        pins = []
        end = self.avr.now + seconds
        while self.avr.now < end and not until(self):
            self.events += self.link.poll(self.avr.now)
            trace = self.avr.run(STEP_MS, self.link.outgoing())
            self.trace += trace
            self.events += self.link.receive(transmitted(trace), self.avr.now)
            pins.append((self.avr.now, self.port(), self.led()))
        return pins

    def ask(self, message: Message) -> None:
        """Sends a request and waits for what comes back."""
        before = len(self.events)
        self.link.request(message, self.avr.now)
        self.run(0.5, until=lambda rig: any(hasattr(event, "request") and event.request == message
                                            for event in rig.events[before:]))  # fmt: skip

    def port(self) -> int:
        return self.avr.read(PORTA)[0]

    def led(self) -> int:
        """Compare value of the LED's timer, 0 when it is not connected to the pin."""
        connected = self.avr.read(TCCR4A)[0] & COM4A1
        return self.avr.read(OCR4A)[0] if connected else 0

    def seen(self, kind: type) -> list:
        """The link's events of one kind."""
        return [event for event in self.events if isinstance(event, kind)]


def transmitted(trace: list[AvrEvent]) -> bytes:
    """The bytes that the program sent."""
    return bytes(event.value for event in trace if event.kind == "T")


def _symbols(program: Path) -> dict[str, int]:
    listed = subprocess.run(["avr-nm", str(program)], check=True, capture_output=True, text=True).stdout
    rows = (line.split() for line in listed.splitlines())
    return {row[2]: int(row[0], 16) for row in rows if len(row) == 3}


def write_image(image: Path, size: int, program: Path, bootloader: Path | None) -> int:
    """Write the flash with these files in Intel hex; return where a reset begins."""
    flash = bytearray(b"\xff" * size)
    first = 0
    for path in filter(None, (program, bootloader)):
        pieces = list(hex_pieces(path.read_text()))
        for address, data in pieces:
            flash[address : address + len(data)] = data
        first = pieces[0][0] if path is bootloader else 0
    image.write_bytes(flash)
    return first


def hex_pieces(text: str) -> Iterator[tuple[int, bytes]]:
    """Address and bytes of each record of data."""
    segment = 0
    for line in text.split():
        length, address_high, address_low, kind, *rest = bytes.fromhex(line[1:])
        data = bytes(rest[:length])
        if kind == 0:
            yield segment + (address_high << 8 | address_low), data
        elif kind in (2, 4):
            segment = int.from_bytes(data, "big") << (4 if kind == 2 else 16)
