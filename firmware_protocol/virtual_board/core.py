"""A board without pins, port or clock: bytes and samples in, pins and bytes out.

The reference of PROTOCOL.md; c/gh_board.c is the same in C, and one test suite runs over both.
"""

from collections.abc import Mapping
from typing import Protocol

from firmware_protocol.errors import DecodeError
from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.messages import (
    CLASS_OF_KIND,
    LAYOUT_OF_KIND,
    PROTOCOL_VERSION,
    AirPair,
    AirVerdict,
    BlockCommit,
    BlockPart,
    BlockRead,
    BlockWrite,
    Capability,
    ClearTrip,
    CommandMessage,
    EmergencyStop,
    EndMaintenance,
    ErrorCode,
    ErrorMessage,
    Header,
    HeaterOffCause,
    HelloRequest,
    Maintenance,
    Message,
    ReleaseStop,
    ResetCause,
    StateEcho,
    TripCause,
    WirePart,
    WireSearch,
    pack,
    read_header,
    unpack,
)
from firmware_protocol.virtual_board.board_config import BoardConfig
from firmware_protocol.virtual_board.board_outputs import Pins
from firmware_protocol.virtual_board.board_safety import Safety
from firmware_protocol.virtual_board.board_samples import AIR, Samples, elapsed_ms, wrap

__all__ = ["BoardCore", "Pins"]

_OPTIONAL = (("led_pct", Capability.LED), ("valve_pulse_s", Capability.VALVE),
             ("cutoff_open", Capability.HEATER_CUTOFF))  # fmt: skip
_COMMAND_FIELDS = tuple(CommandMessage.__dataclass_fields__)


_SETUP = (BlockRead, BlockWrite, BlockCommit, WireSearch)


class BoardSetup(Protocol):
    """Two copies of the block of `board_block`, one in force and a spare one; the search for parts."""

    def read(self, part: int) -> bytes:
        """Return 16 bytes of the one in force."""

    def write(self, part: int, data: bytes) -> bytes:
        """Write 16 bytes of the spare one, and return what it then holds there."""

    def commit(self) -> bool:
        """Take the spare one into force; False, and nothing changes, for a bad one."""

    def find(self, first: bool) -> int:
        """Return the ROM code of the next part on the 1-Wire, 0 for none."""


class BoardCore:
    """One start of a board, from reset to reset. All times are the board's clock [ms], which may wrap.

    restart : a new configuration is in force; a reset is due as soon as what waits is sent
    """

    def __init__(
        self,
        config: BoardConfig,
        persistent: bytes,
        reset_cause: int,
        boot_count: int,
        setup: BoardSetup | None = None,
    ) -> None:
        self.restart = False
        self._setup = setup if config.has(Capability.CONFIGURABLE) else None
        self.dropped = 0  # whole frames that no answer can be given to
        self.decoder = FrameDecoder()
        self._config = config
        self._reset_cause = ResetCause(reset_cause)
        self._boot_count = boot_count
        self._safety = Safety(config, persistent)
        self._samples = Samples()
        self._air_pair: AirPair | None = None
        self._seq = 0
        self._answered: tuple[int, Message] | None = None  # newest request's seq and what was said to it
        self._told: tuple[HeaterOffCause, TripCause] | None = None  # by the last state_echo since a hello
        self._report_ms = 0  # multiple of the report period that was passed last
        self._transmit = bytearray()
        self._send_hello(0, 0)

    def receive(self, data: bytes, now_ms: int) -> None:
        """Bytes from the line."""
        self._advance(now_ms)
        for payload in self.decoder.feed(data):
            self._take(payload, wrap(now_ms))
            self._advance(now_ms)  # a command with no lease has let go before the next frame is looked at

    def sample(self, samples: Mapping[str, tuple[float | None, int]], now_ms: int) -> None:
        """Take new samples: a key of board_samples.SIGNALS -> (value in its unit or None, Quality)."""
        self._advance(now_ms)
        for signal, (value, quality) in samples.items():
            sample = self._samples.take(signal, value, quality, wrap(now_ms))
            if signal == AIR:
                self._safety.sample_air(sample)

    def sample_pair(self, first_c: float | None, second_c: float | None, verdict: AirVerdict) -> None:
        """Take what two air sensors show; told after each report."""
        self._air_pair = AirPair(first_c, second_c, verdict)

    def step(self, now_ms: int) -> Pins:
        """Advance and return the new outputs; to be called at least every 100 ms."""
        self._advance(now_ms)
        if self._told != (self._safety.heater_off_cause, self._safety.trip_cause):
            self._send(self._state(wrap(now_ms)), 0)
        passed = elapsed_ms(now_ms, self._report_ms) // self._config.report_period_ms
        if passed > 0:
            self._report_ms += passed * self._config.report_period_ms
            self._send(self._samples.report(wrap(now_ms)), 0)
            if self._air_pair is not None:
                self._send(self._air_pair, 0)
        return self._safety.pins()

    def transmit(self) -> bytes:
        """Return the bytes for the line since the last call."""
        data = bytes(self._transmit)
        self._transmit.clear()
        return data

    def persistent(self) -> bytes:
        """Return the bytes that must survive a reset, to be stored when they change."""
        return self._safety.persistent()

    def _advance(self, now_ms: int) -> None:
        self._samples.advance(now_ms)
        self._safety.advance(now_ms)

    def _take(self, payload: bytes, now_ms: int) -> None:
        header = read_header(payload)
        if header.version != PROTOCOL_VERSION:
            self._send(ErrorMessage(ErrorCode.VERSION, PROTOCOL_VERSION), header.seq)
        elif _sent_by_boards(header.kind) or header.seq == 0:
            self.dropped += 1  # a line that leads back to its sender would answer itself for ever
        else:
            self._serve(header, payload, now_ms)

    def _serve(self, header: Header, payload: bytes, now_ms: int) -> None:
        try:
            message: Message | DecodeError = unpack(payload)[1]
        except DecodeError as error:
            message = error
        if self._setup is None and CLASS_OF_KIND.get(header.kind) in _SETUP:
            message = DecodeError(ErrorCode.UNKNOWN_KIND, header.kind)
        if isinstance(message, HelloRequest):
            self._safety.greeted = True
            self._answered = None
            self._send_hello(message.session, header.seq)
            return
        if self._answered is None or self._answered[0] != header.seq:
            answer = self._answer(message, header.kind, now_ms)
            if not self._safety.greeted:
                self._send(answer, header.seq)
                return
            self._answered = header.seq, answer
        self._send(self._answered[1], header.seq)

    def _answer(self, message: Message | DecodeError, kind: int, now_ms: int) -> Message:
        if isinstance(message, DecodeError):
            return ErrorMessage(ErrorCode(message.code), message.detail)
        if not self._safety.greeted:
            return ErrorMessage(ErrorCode.NOT_GREETED, kind)
        if self._setup is not None and isinstance(message, _SETUP):
            return self._set_up(message, self._setup) or self._state(now_ms)
        return self._refusal(message, now_ms) or self._state(now_ms)

    def _set_up(
        self, message: BlockRead | BlockWrite | BlockCommit | WireSearch, setup: BoardSetup
    ) -> Message | None:
        """Return the answer, None for the state."""
        if isinstance(message, BlockRead):
            return _part(message.part, setup.read(message.part))
        if self._safety.heater_steps > 0:
            return ErrorMessage(ErrorCode.HEATING, self._safety.heater_steps)
        if isinstance(message, WireSearch):
            return WirePart(setup.find(message.first))
        if isinstance(message, BlockWrite):
            data = message.low.to_bytes(8, "little") + message.high.to_bytes(8, "little")
            return _part(message.part, setup.write(message.part, data))
        if not setup.commit():
            return ErrorMessage(ErrorCode.BAD_BLOCK, 0)
        self.restart = True
        return None

    def _refusal(self, message: Message, now_ms: int) -> ErrorMessage | None:
        obeyed = True
        match message:
            case CommandMessage():
                for name, part in _OPTIONAL:
                    if getattr(message, name) and not self._config.has(part):
                        return ErrorMessage(ErrorCode.NO_ACTUATOR, _COMMAND_FIELDS.index(name))
                obeyed = self._safety.obey(message, now_ms)
            case ClearTrip():
                obeyed = self._safety.clear_trip()
            case EmergencyStop():
                self._safety.trip(TripCause.EMERGENCY_STOP)
            case Maintenance():
                self._safety.trip(TripCause.MAINTENANCE)
            case ReleaseStop():
                self._safety.release(TripCause.EMERGENCY_STOP)
            case EndMaintenance():
                self._safety.release(TripCause.MAINTENANCE)
        return None if obeyed else ErrorMessage(ErrorCode.TRIPPED, self._safety.trip_cause)

    def _state(self, now_ms: int) -> StateEcho:
        safety = self._safety
        pins = safety.pins()
        self._told = safety.heater_off_cause, safety.trip_cause
        return StateEcho(
            board_ms=now_ms,
            heater_steps=safety.heater_steps,
            heater_off_cause=safety.heater_off_cause,
            fan_on=pins.fan,
            led_pct=safety.led_pct,
            valve_open=pins.valve,
            cutoff_open=pins.cutoff_open,
            tripped=safety.tripped,
            trip_cause=safety.trip_cause,
            lease_left_s=safety.lease_left_ms(now_ms) / 1000,
            fan_rpm=self._samples.fan_rpm(),
        )

    def _send_hello(self, session: int, ack: int) -> None:
        self._send(self._config.hello(session, self._reset_cause, self._boot_count), ack)
        self._told = None

    def _send(self, message: Message, ack: int) -> None:
        self._seq = self._seq % 255 + 1
        self._transmit += encode(pack(message, self._seq, ack))


def _part(part: int, data: bytes) -> BlockPart:
    return BlockPart(part, int.from_bytes(data[:8], "little"), int.from_bytes(data[8:], "little"))


def _sent_by_boards(kind: int) -> bool:
    layout = LAYOUT_OF_KIND.get(kind)
    return layout is not None and layout.from_board
