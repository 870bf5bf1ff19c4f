"""A dialogue with a board outside the daemon, for `greenhouse board` and `setup`."""

import random
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from edge.board.serial_port import OpenPort, PortGone, SerialPort
from edge.core.clock import Clock, RealClock
from edge.core.errors import RequestError
from firmware_protocol.board_block import BLOCK_SIZE, PART_BYTES
from firmware_protocol.link import (
    BoardReset,
    Link,
    LinkEcho,
    LinkEvent,
    LinkLost,
    LinkSetup,
    LinkUp,
    Report,
    RequestRefused,
    RequestTimedOut,
    VersionRefused,
)
from firmware_protocol.messages import (
    BlockCommit,
    BlockPart,
    BlockRead,
    BlockWrite,
    Capability,
    CommandMessage,
    ErrorCode,
    Hello,
    Message,
    Ping,
    SensorReport,
    StateEcho,
    WirePart,
    WireSearch,
)

BAUDRATE = 115_200
GREETED_S = 14.0  # an Arduino resets when its port is opened; a Mega's bootloader then listens for 6 s
ANSWERED_S = 2.0  # five sends of a request take 1.25 s
RESET_S = 12.0  # through a bootloader
WAIT_S = 0.05
WIRE_PARTS_MAX = 32  # a search that a disturbance leads in circles ends
OFF = CommandMessage(0, fan_on=0, led_pct=0, valve_pulse_s=0.0, cutoff_open=True, lease_s=0.0)
REFUSALS = {
    ErrorCode.HEATING: "the heater is driven; stop it first (`greenhouse board show` tells when it is off)",
    ErrorCode.BAD_BLOCK: "the board refuses this configuration: is it for another microcontroller?",
    ErrorCode.TRIPPED: "the board is tripped or stopped: `greenhouse board show` tells by what",
    ErrorCode.UNKNOWN_KIND: "its program takes no configuration; flash it with `greenhouse board flash`",
}


class NobodyAnswers(RequestError):
    """The port opens, but no board answers in this protocol's version: it is not flashed, or another one."""


class BoardSession:
    """An open port with a board that has answered. Every method: Errors: RequestError"""

    def __init__(self, path: str, open_port: OpenPort = SerialPort, clock: Clock | None = None) -> None:
        self.path = path
        self.clock = clock or RealClock()
        self._drives = False  # an output has a lease of this session
        try:
            self._port = open_port(path, BAUDRATE)
        except PortGone as error:
            raise RequestError(f"{path}: {_why_not_open(path, str(error))}") from None
        self._link = Link(session=random.getrandbits(32), now=self.clock.now())
        try:
            self.hello = self._greet()
        except BaseException:
            self._port.close()
            raise

    def __enter__(self) -> "BoardSession":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Turn off what this session drives, and give the port back."""
        try:
            with suppress(RequestError):
                self.turn_off()
        finally:
            self._port.close()

    def state(self) -> StateEcho:
        """Return the board's outputs."""
        answer = self._ask(Ping())
        assert isinstance(answer, StateEcho)
        return answer

    def report(self) -> SensorReport:
        """Return the next report of the sensors."""
        patience_s = 3.0 * self.hello.report_period_s
        report: SensorReport = self._wait((Report,), patience_s, "no report of its sensors").report
        return report

    def drive(self, command: CommandMessage) -> StateEcho:
        """Drive outputs until the command's lease ends, and return what the board does."""
        self._drives = True
        answer = self._ask(command)
        assert isinstance(answer, StateEcho)
        return answer

    def turn_off(self) -> None:
        """End every lease. A board that cannot be reached does so itself when the last lease ends."""
        if self._drives:
            parts = self.hello.capabilities
            self._ask(replace(OFF, cutoff_open=bool(parts & Capability.HEATER_CUTOFF)))
            self._drives = False

    def block(self) -> bytes | None:
        """Return the configuration in force, None for a board that has none in its EEPROM."""
        if not self.hello.capabilities & Capability.CONFIGURABLE:
            return None
        parts = [self._ask(BlockRead(part)) for part in range(BLOCK_SIZE // PART_BYTES)]
        return b"".join(_bytes_of(part) for part in parts if isinstance(part, BlockPart))

    def wire_parts(self) -> list[int]:
        """Return the ROM codes of the parts on the 1-Wire."""
        found: list[int] = []
        while len(found) < WIRE_PARTS_MAX:
            answer = self._ask(WireSearch(first=not found))
            if not isinstance(answer, WirePart) or answer.rom == 0:
                break
            found.append(answer.rom)
        return sorted(found)

    def write_block(self, block: bytes) -> None:
        """Put a configuration into force, and check that it is."""
        for part in range(BLOCK_SIZE // PART_BYTES):
            data = block[part * PART_BYTES :][:PART_BYTES]
            low, high = int.from_bytes(data[:8], "little"), int.from_bytes(data[8:], "little")
            if self._ask(BlockWrite(part, low, high)) != BlockPart(part, low, high):
                raise RequestError(f"{self.path}: the EEPROM does not hold what was written to it")
        self._ask(BlockCommit())
        self._wait((BoardReset,), RESET_S, "it does not start anew", may_be_silent=True)
        self.hello = self._greet()
        if self.block() != block:
            raise RequestError(f"{self.path}: another configuration is in force than the one written")

    def _greet(self) -> Hello:
        try:
            hello: Hello = self._wait((LinkUp,), GREETED_S, "", may_be_silent=True).hello
        except TimeoutError:
            raise NobodyAnswers(f"{self.path}: no board answers in this protocol; is it flashed?") from None
        return hello

    def _ask(self, request: Message) -> Message:
        """Return the answer to a request."""
        self._link.request(request, self.clock.now())
        found = self._wait((LinkEcho, LinkSetup), ANSWERED_S, "no answer", request)
        answer: Message = found.answer if isinstance(found, LinkSetup) else found.state
        return answer

    def _wait(
        self,
        kinds: tuple[type[LinkEvent], ...],
        patience_s: float,
        problem: str,
        request: Message | None = None,
        may_be_silent: bool = False,
    ) -> Any:
        """Return the first event of these kinds, that answers the request if there is one.

        Errors: RequestError; TimeoutError where `problem` is empty
        """
        end_s = self.clock.now() + patience_s
        while self.clock.now() < end_s:
            for event in self._take_events():
                self._check(event, may_be_silent)
                if isinstance(event, kinds) and (
                    request is None or getattr(event, "request", None) == request
                ):
                    return event
        if not problem:
            raise TimeoutError
        raise RequestError(f"{self.path}: {problem}")

    def _check(self, event: LinkEvent, may_be_silent: bool) -> None:
        match event:
            case VersionRefused():
                versions = f"{event.protocol_min} to {event.protocol_max}"
                raise NobodyAnswers(f"{self.path}: the board speaks protocol {versions} only; flash it anew")
            case RequestRefused():
                code = event.error.code
                raise RequestError(f"{self.path}: {REFUSALS.get(code, code.name.lower())}")
            case RequestTimedOut() | LinkLost() if not may_be_silent:
                raise RequestError(f"{self.path}: the board fell silent")

    def _take_events(self) -> list[LinkEvent]:
        """Serve the line for a moment and return what happened."""
        try:
            self.clock.wait(self._port, None, self.clock.now() + WAIT_S)
            now = self.clock.now()
            events = self._link.receive(self._port.read(), now) + self._link.poll(now)
            outgoing = self._link.outgoing()
            if outgoing:
                self._port.write(outgoing)
        except PortGone as error:
            raise RequestError(f"{self.path}: the port is gone: {error}") from None
        return events


def _bytes_of(part: BlockPart) -> bytes:
    return part.low.to_bytes(8, "little") + part.high.to_bytes(8, "little")


def _why_not_open(path: str, said: str) -> str:
    if not Path(path).exists():
        return "there is no such port; is the board plugged in? `ls /dev/ttyACM* /dev/ttyUSB*` lists ports"
    if "exclusively lock" in said or "busy" in said.lower():
        return "another process has the port; the daemon? `systemctl stop greenhouse` gives it back"
    return said
