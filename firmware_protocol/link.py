"""The host's end of the link, a state machine without I/O: bytes and time in, bytes and events out.

    for event in link.receive(port.read(), now) + link.poll(now): ...
    port.write(link.outgoing())

Nothing that the board may send or the line may do raises; see PROTOCOL.md, "The host".
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from firmware_protocol.errors import DecodeError, LocalProtocolError
from firmware_protocol.frame import FrameDecoder, encode
from firmware_protocol.link_events import (
    BoardReset,
    LinkEcho,
    LinkEvent,
    LinkLost,
    LinkSetup,
    LinkUp,
    Nonsense,
    PairTold,
    Report,
    RequestRefused,
    RequestTimedOut,
    VersionRefused,
)
from firmware_protocol.messages import (
    HEADER_LENGTH,
    LAYOUTS,
    PROTOCOL_VERSION,
    AirPair,
    BlockPart,
    EmergencyStop,
    ErrorCode,
    ErrorMessage,
    Header,
    Hello,
    HelloRequest,
    Maintenance,
    Message,
    SensorReport,
    StateEcho,
    WirePart,
    pack,
    read_header,
    unpack,
)

__all__ = [
    "BoardReset",
    "Link",
    "LinkEcho",
    "LinkEvent",
    "LinkLost",
    "LinkSetup",
    "LinkUp",
    "Nonsense",
    "PairTold",
    "Report",
    "RequestRefused",
    "RequestTimedOut",
    "VersionRefused",
]  # fmt: skip

GREET_S = 1.0  # between two greetings of a board that is heard
# Of one that is not: an Arduino resets when its port is opened, and a Mega's bootloader starts the program
# only after 6 s without a byte.
GREET_SILENT_S = 12.0
HEARD_S = 6.0  # so long after its last whole frame a board is heard, while the port stays open
GREET_REFUSED_S = 10.0  # the same after a board said that it speaks other versions
RETRY_S = 0.25
SENDS = 5  # of one request, the first included
STOPS = (EmergencyStop, Maintenance)  # they wait for nothing but each other
SILENCE_S = 3.0  # without a whole frame the link is lost; three report periods where that is longer


@dataclass(slots=True)
class _UnderWay:
    message: Message
    seq: int
    frame: bytes
    sends: int
    retry_at: float


class Link:
    """One host's end. All times are the caller's, monotonic [s].

    session : a random number, so that a restarted host's greeting is not taken for the old one's
    """

    def __init__(self, session: int, now: float) -> None:
        self.state: Literal["down", "up", "refused"] = "down"
        self._session = session % 2**32
        self._decoder = FrameDecoder()
        self._counts: Counter[str] = Counter()
        self._seq = 0
        self._greeting_seq = 0  # 0: none sent in this session
        self._greet_at = now
        self._greeted_at = now
        self._runs_until = now  # its program, as far as one can know
        self._heard_at = now
        self._silence_s = SILENCE_S
        self._under_way: _UnderWay | None = None
        self._waiting: list[Message] = []
        self._outgoing = b""
        self._last_payload = b""
        self._boot: tuple[int, int] | None = None  # board id and boot count of the last hello
        self._untold: list[LinkEvent] = []  # found by `request`, told by the next receive or poll

    @property
    def statistics(self) -> Mapping[str, int]:
        """Counters since the start."""
        decoder = self._decoder
        return self._counts | {
            "too_long": decoder.too_long, "bad_cobs": decoder.bad_cobs, "too_short": decoder.too_short,
            "bad_crc": decoder.bad_crc,
        }  # fmt: skip

    def request(self, message: Message, now: float) -> None:
        """Send a request, or let it wait for the one under way; it replaces one of its kind that waits.

        An emergency stop or a maintenance goes out at once; all but these two are given up. While the link is
        not up every request is given up: RequestTimedOut. Raises LocalProtocolError for what is no request or
        can't be sent.
        """
        if LAYOUTS[type(message)].from_board or isinstance(message, HelloRequest):
            raise LocalProtocolError(f"{type(message).__name__} is no request")
        pack(message, 0)  # a value out of range is to be found here
        if self.state != "up":
            self._untold.append(RequestTimedOut(message))
            return
        if isinstance(message, STOPS):
            self._untold += self._give_up_requests(STOPS)
        if self._under_way is None:
            self._send(message, now)
            return
        kept = [waiting for waiting in self._waiting if type(waiting) is not type(message)]
        self._counts["replaced"] += len(self._waiting) - len(kept)
        self._waiting = [*kept, message]

    def receive(self, data: bytes, now: float) -> list[LinkEvent]:
        """Take bytes from the line."""
        events, self._untold = self._untold, []
        nonsense_before = self._decoder.nonsense
        for payload in self._decoder.feed(data):
            self._counts["frames"] += 1
            self._runs_until = now + HEARD_S
            if self.state == "down":
                self._greet_at = min(self._greet_at, self._greeted_at + GREET_S)
            if payload == self._last_payload:
                self._counts["duplicates"] += 1
                continue
            self._last_payload = payload
            events += self._take(payload, now)
        damaged = self._decoder.nonsense - nonsense_before
        return [*events, Nonsense(damaged)] if damaged else events

    def poll(self, now: float) -> list[LinkEvent]:
        """Do what is due: greet, repeat a request, give it up, notice silence."""
        events, self._untold = self._untold, []
        waiting = self._under_way
        if self.state == "up" and now >= self._silent_at:
            events += self._end_session(now)
        elif self.state == "up" and waiting is not None and now >= waiting.retry_at:
            if waiting.sends < SENDS:
                self._repeat(waiting, now)
            else:
                events += self._end_session(now)
        if self.state != "up" and now >= self._greet_at:
            self._greet(now)
        return events

    def disconnect(self, now: float) -> list[LinkEvent]:
        """Handle a closed port: forget half a frame, end the session, greet again."""
        events, self._untold = self._untold, []
        self._decoder.reset()
        self._runs_until = now
        return events + self._end_session(now)

    def outgoing(self) -> bytes:
        """Return the bytes to write now; at most one frame, since a newer one
        replaces one that was not taken.
        """
        data, self._outgoing = self._outgoing, b""
        return data

    def next_deadline(self) -> float:
        """When `poll` has to be called next."""
        if self._untold:
            return 0.0
        if self.state != "up":
            return self._greet_at
        if self._under_way is None:
            return self._silent_at
        return min(self._silent_at, self._under_way.retry_at)

    @property
    def _silent_at(self) -> float:
        return self._heard_at + self._silence_s

    def _take(self, payload: bytes, now: float) -> list[LinkEvent]:
        header = read_header(payload)
        if header.version != PROTOCOL_VERSION:
            return self._take_other_version(header, payload[HEADER_LENGTH:], now)
        try:
            message = unpack(payload)[1]
        except DecodeError:
            return self._not_understood()
        if not LAYOUTS[type(message)].from_board:  # a line that leads back to its sender
            return self._not_understood()
        self._heard_at = now
        match message:
            case SensorReport():
                return [Report(message)]
            case AirPair():
                return [PairTold(message)]
            case Hello():
                return self._take_hello(header, message, now)
            case StateEcho() if header.ack == 0:
                return [LinkEcho(message, None)]
            case StateEcho() | ErrorMessage() | BlockPart() | WirePart():
                return self._take_answer(header, message, now)
        return []

    def _not_understood(self) -> list[LinkEvent]:
        self._counts["not_understood"] += 1
        return [Nonsense(1)]

    def _take_other_version(self, header: Header, body: bytes, now: float) -> list[LinkEvent]:
        is_error = header.kind == LAYOUTS[ErrorMessage].kind and len(body) >= 2
        if is_error and body[0] == ErrorCode.VERSION and self._answers_greeting(header):
            return self._refuse(body[1], body[1], now)
        return self._not_understood()

    def _answers_greeting(self, header: Header) -> bool:
        return self.state != "up" and header.ack != 0 and header.ack == self._greeting_seq

    def _take_hello(self, header: Header, hello: Hello, now: float) -> list[LinkEvent]:
        boot = hello.board_id, hello.boot_count
        if header.ack == 0:
            self._boot = boot
            events = self._give_up_requests()
            self._begin_session(now)
            return [BoardReset(hello), *events]
        if not self._answers_greeting(header) or hello.session != self._session:
            return self._stale()
        reset: list[LinkEvent] = [BoardReset(hello)] if self._boot not in (None, boot) else []
        self._boot = boot
        if not hello.protocol_min <= PROTOCOL_VERSION <= hello.protocol_max:
            return reset + self._refuse(hello.protocol_min, hello.protocol_max, now)
        self.state = "up"
        self._silence_s = max(SILENCE_S, 3 * hello.report_period_s)
        return [*reset, LinkUp(hello)]

    def _take_answer(
        self, header: Header, answer: StateEcho | ErrorMessage | BlockPart | WirePart, now: float
    ) -> list[LinkEvent]:
        if self._answers_greeting(header):
            if isinstance(answer, ErrorMessage) and answer.code is ErrorCode.VERSION:
                return self._refuse(answer.detail, answer.detail, now)
            return self._stale()
        request = self._under_way
        if request is None or header.ack != request.seq:
            return self._stale()
        self._under_way = None
        if isinstance(answer, ErrorMessage):
            refused: list[LinkEvent] = [RequestRefused(answer, request.message)]
            if answer.code is ErrorCode.NOT_GREETED:
                return refused + self._end_session(now)
            self._send_waiting(now)
            return refused
        self._send_waiting(now)
        if isinstance(answer, BlockPart | WirePart):
            return [LinkSetup(answer, request.message)]
        return [LinkEcho(answer, request.message)]

    def _stale(self) -> list[LinkEvent]:
        self._counts["stale"] += 1
        return []

    def _refuse(self, low: int, high: int, now: float) -> list[LinkEvent]:
        self._greet_at = now + GREET_REFUSED_S
        if self.state == "refused":
            return []
        self.state = "refused"
        return [VersionRefused(low, high)]

    def _end_session(self, now: float) -> list[LinkEvent]:
        lost: list[LinkEvent] = [LinkLost(now - self._heard_at)] if self.state == "up" else []
        events = self._give_up_requests() + lost
        self._begin_session(now)
        return events

    def _begin_session(self, now: float) -> None:
        self.state = "down"
        self._session = (self._session + 1) % 2**32
        self._greeting_seq = 0
        self._greet_at = now

    def _give_up_requests(self, but: tuple[type[Message], ...] = ()) -> list[LinkEvent]:
        given_up = []
        if self._under_way is not None and not isinstance(self._under_way.message, but):
            given_up.append(self._under_way.message)
            self._under_way = None
            self._outgoing = b""
        given_up += [message for message in self._waiting if not isinstance(message, but)]
        self._waiting = [message for message in self._waiting if isinstance(message, but)]
        self._counts["given_up"] += len(given_up)
        return [RequestTimedOut(message) for message in given_up]

    def _next_seq(self) -> int:
        self._seq = self._seq % 255 + 1
        return self._seq

    def _greet(self, now: float) -> None:
        self._counts["greetings"] += 1
        if self._greeting_seq == 0:
            self._greeting_seq = self._next_seq()
        frame = encode(pack(HelloRequest(self._session), self._greeting_seq))
        self._outgoing = b"\0" + frame  # ends whatever noise left in the board's decoder
        self._greeted_at = now
        pause_s = GREET_S if now < self._runs_until else GREET_SILENT_S
        self._greet_at = now + (GREET_REFUSED_S if self.state == "refused" else pause_s)

    def _send(self, message: Message, now: float) -> None:
        seq = self._next_seq()
        frame = encode(pack(message, seq))
        self._under_way = _UnderWay(message, seq, frame, 1, now + RETRY_S)
        self._outgoing = frame

    def _repeat(self, request: _UnderWay, now: float) -> None:
        self._counts["retries"] += 1
        request.sends += 1
        request.retry_at = now + RETRY_S
        self._outgoing = b"\0" + request.frame

    def _send_waiting(self, now: float) -> None:
        if self._waiting:
            self._send(self._waiting.pop(0), now)
