"""Lines between two ends, in memory and without clocks: each takes bytes and the time and gives bytes later.

All are first in, first out, as a serial line is; what they spoil is decided by a seed.
"""

import random
from dataclasses import dataclass, field
from typing import Any

from edge.board.serial_port import PortGone, SerialPort
from edge.board.sim_clock import SimClock
from firmware_protocol.link import Link, LinkEvent, Report
from firmware_protocol.messages import CommandMessage
from tests.support.virtual_board import VirtualBoard

RENEW_S = 3.0


@dataclass
class GoodLine:
    """A good line. `carry` takes what was written now and returns what arrives now [bytes], time in s."""

    def carry(self, data: bytes, now: float) -> bytes:
        return data


@dataclass
class BytewiseLine(GoodLine):
    """Delivers a byte (or a few) each time it is asked."""

    at_once: int = 1
    held: bytearray = field(default_factory=bytearray)

    def carry(self, data: bytes, now: float) -> bytes:
        self.held += data
        arrived = bytes(self.held[: self.at_once])
        del self.held[: self.at_once]
        return arrived


@dataclass
class DelayedLine(GoodLine):
    """Delivers everything `delay_s` later."""

    delay_s: float
    held: list[tuple[float, bytes]] = field(default_factory=list)

    def carry(self, data: bytes, now: float) -> bytes:
        if data:
            self.held.append((now + self.delay_s, data))
        arrived = b"".join(part for due, part in self.held if due <= now)
        self.held = [(due, part) for due, part in self.held if due > now]
        return arrived


@dataclass
class DuplicatingLine(GoodLine):
    """Delivers every frame twice, at random."""

    seed: int
    share: float = 0.5
    held: bytearray = field(default_factory=bytearray)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def carry(self, data: bytes, now: float) -> bytes:
        self.held += data
        *frames, rest = bytes(self.held).split(b"\0")
        self.held = bytearray(rest)
        copies = (2 if self._random.random() < self.share else 1 for _ in frames)
        return b"".join((frame + b"\0") * n for frame, n in zip(frames, copies, strict=True))


@dataclass
class LossyLine(GoodLine):
    """Drops, flips and inserts bytes, each with a probability of its own."""

    seed: int
    drop: float = 0.0
    flip: float = 0.0
    insert: float = 0.0

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def carry(self, data: bytes, now: float) -> bytes:
        out = bytearray()
        for byte in data:
            if self._random.random() < self.insert:
                out.append(self._random.randrange(256))
            if self._random.random() < self.drop:
                continue
            flipped = 1 << self._random.randrange(8) if self._random.random() < self.flip else 0
            out.append(byte ^ flipped)
        return bytes(out)


@dataclass
class CutLine(GoodLine):
    """Loses everything from `from_s` to `until_s`."""

    from_s: float
    until_s: float

    def carry(self, data: bytes, now: float) -> bytes:
        return b"" if self.from_s <= now < self.until_s else data


@dataclass
class NoisyLine(GoodLine):
    """A good line on which noise follows every delivery."""

    seed: int
    share: float = 0.2

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def carry(self, data: bytes, now: float) -> bytes:
        if self._random.random() < self.share:
            return data + self._random.randbytes(self._random.randrange(1, 80))
        return data


class LineHost:
    """Greets, keeps what it received, and renews a command while it serves."""

    def __init__(self, board: VirtualBoard) -> None:
        self.clock = SimClock(board.control)
        self.received = b""
        self.events: list[LinkEvent] = []
        self.errors: list[PortGone] = []
        self.command: CommandMessage | None = None
        self._path = str(board.port)
        self._port: SerialPort | None = None
        self._link = Link(session=1, now=self.clock.now())
        self._renew_s = 0.0

    def __enter__(self) -> "LineHost":
        return self

    def __exit__(self, *_: object) -> None:
        self.close_port()
        self.clock.close()

    @property
    def up(self) -> bool:
        return self._link.state == "up"

    def seen(self, kind: type) -> list[Any]:
        """The events of one kind."""
        return [event for event in self.events if isinstance(event, kind)]

    def reports(self) -> list[Any]:
        return [event.report for event in self.seen(Report)]

    def heat(self) -> None:
        """From now on: full heat, fan off, cut-off closed, the longest lease."""
        self.command = CommandMessage(
            heater_steps=20, fan_on=0, led_pct=0, valve_pulse_s=0.0, cutoff_open=0, lease_s=10.0
        )
        self._renew_s = self.clock.now()

    def close_port(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def serve(self, until_s: float) -> None:
        """Keep the line alive until then."""
        while self.clock.now() < until_s:
            now = self.clock.now()
            self._open()
            self.events += self._link.poll(now)
            if self.command is not None and self.up and now >= self._renew_s:
                self._renew_s = now + RENEW_S
                self._link.request(self.command, now)
            try:
                self._exchange(min(until_s, self._link.next_deadline(), now + 1.0))
            except PortGone as error:
                self.errors.append(error)
                self.close_port()
                self.events += self._link.disconnect(self.clock.now())

    def _open(self) -> None:
        if self._port is None:
            try:
                self._port = SerialPort(self._path, 115200)
            except PortGone:
                return  # not plugged in: try again at the next turn

    def _exchange(self, until_s: float) -> None:
        if self._port is not None:
            self._port.write(self._link.outgoing())
        self.clock.wait(self._port, None, until_s)
        if self._port is not None:
            data = self._port.read()
            self.received += data
            self.events += self._link.receive(data, self.clock.now())
