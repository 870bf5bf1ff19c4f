"""A batch: what messages mean, before anything of it is stored."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from edge.core.plain_text import plain, quote
from fleet.ingest.inbox import Message
from fleet.ingest.ledger import RigLedger
from fleet.ingest.spans import Refused, Span
from fleet.ingest.state import HeardTwin, parse_state, parse_twin
from fleet.ingest.tick import PAYLOAD_MAX, Tick, parse_body, parse_tick

CLEARED = ("availability", "state", "twin")  # retained topics: without a payload the broker keeps none


@dataclass(frozen=True, slots=True)
class Times:
    """utc and monotonic : now [s]; oldest_utc : of a tick that is taken"""

    utc: float
    monotonic: float
    oldest_utc: float


@dataclass(slots=True)
class Batch:
    """rigs : what each rig that was heard says of itself; absent : what rigs have said that they have not

    gone : rigs that nobody speaks for any more
    twins : the newest by rig, None of a rig that takes its own back
    """

    times: Times
    rigs: dict[str, dict[str, Any]] = field(default_factory=dict)
    ticks: list[Tick] = field(default_factory=list)
    gone: set[str] = field(default_factory=set)
    twins: dict[str, HeardTwin | None] = field(default_factory=dict)
    absent: list[tuple[str, str, Span]] = field(default_factory=list)
    refused: list[tuple[str, Refused]] = field(default_factory=list)

    def hear(self, message: Message, ledger: RigLedger) -> None:
        """Take one message of a rig in."""
        if not message.size and message.what in CLEARED:
            self._clear(message, ledger)
            return
        values = self.rigs.setdefault(message.rig, {})
        if not message.is_retained:
            values["last_utc"] = self.times.utc
        try:
            _HEARD[message.what](self, message, ledger)
        except Refused as error:
            self.refused.append((message.rig, error))
        except Exception as error:  # our mistake; counted, for it would stop all other rigs, again and again
            self.refused.append((message.rig, Refused("fault", f"{message.what}: {plain(repr(error))}")))

    def _clear(self, message: Message, ledger: RigLedger) -> None:
        """Take a retained topic that was emptied: the rig is not heard by that, for it was removed."""
        if message.what == "twin":
            self.twins[message.rig] = None
        elif message.what == "availability":
            ledger.is_online = False
            self.gone.add(message.rig)

    def _availability(self, message: Message, ledger: RigLedger) -> None:
        if message.payload not in (b"online", b"offline"):
            raise Refused("value", f"availability: {quote(message.payload)} is not online or offline")
        ledger.is_online = message.payload == b"online"
        self.rigs[message.rig]["is_online"] = ledger.is_online
        self.gone.discard(message.rig)

    def _state(self, message: Message, ledger: RigLedger) -> None:
        _check_size(message)
        state = parse_state(message.payload)
        ledger.told = state["seq"]
        self.rigs[message.rig]["state"] = state

    def _tick(self, message: Message, ledger: RigLedger) -> None:
        _check_size(message)
        tick = parse_tick(message.rig, message.payload, self.times.oldest_utc, self.times.utc)
        self.ticks.append(tick)
        if tick.unknown:
            self.refused.append(
                (message.rig, Refused("quantity", f"tick {tick.seq}: unknown: {tick.unknown}"))
            )

    def _twin(self, message: Message, ledger: RigLedger) -> None:
        _check_size(message)
        self.twins[message.rig] = parse_twin(message.payload)

    def _reply(self, message: Message, ledger: RigLedger) -> None:
        """Take the answer to a resend; answers to others' orders are none of ours."""
        if b'"resend"' not in message.payload:
            return
        answer = parse_body(message.payload)
        span, queued = (answer.get("first_seq"), answer.get("last_seq")), answer.get("queued")
        if answer.get("command") == "resend" and answer.get("ok") is True and isinstance(queued, int):
            self._answer(message.rig, span, queued, ledger)

    def _answer(self, rig: str, span: Any, queued: int, ledger: RigLedger) -> None:
        absent = ledger.asks.answer(span, queued, self.times.monotonic)
        if absent is not None and ledger.current:
            self.absent.append((rig, ledger.current, absent))


def _check_size(message: Message) -> None:
    if message.size > PAYLOAD_MAX:
        raise Refused("size", f"{message.what}: {message.size} bytes; {PAYLOAD_MAX} at most")


_HEARD: dict[str, Callable[[Batch, Message, RigLedger], None]] = {
    "availability": Batch._availability,
    "state": Batch._state,
    "history/tick": Batch._tick,
    "twin": Batch._twin,
    "reply": Batch._reply,
}
