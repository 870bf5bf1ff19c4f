"""Events of the link's host end."""

from dataclasses import dataclass

from firmware_protocol.messages import (
    AirPair,
    BlockPart,
    ErrorMessage,
    Hello,
    Message,
    SensorReport,
    StateEcho,
    WirePart,
)


@dataclass(frozen=True, slots=True)
class LinkUp:
    """The board answered the greeting; requests may be sent."""

    hello: Hello


@dataclass(frozen=True, slots=True)
class LinkLost:
    """The session is over: silence, no answer to a request, a board that knows no session, a lost port."""

    silent_s: float  # since the last whole frame


@dataclass(frozen=True, slots=True)
class BoardReset:
    """The board has started anew since it was last heard; the session, if there was one, is over."""

    hello: Hello


@dataclass(frozen=True, slots=True)
class VersionRefused:
    """The board speaks only other versions than ours."""

    protocol_min: int
    protocol_max: int


@dataclass(frozen=True, slots=True)
class Report:
    """The board's sensors."""

    report: SensorReport


@dataclass(frozen=True, slots=True)
class PairTold:
    """The board's two air sensors, one by one."""

    pair: AirPair


@dataclass(frozen=True, slots=True)
class LinkEcho:
    """The board's outputs; `request` is the one it answers, None when it was sent unasked."""

    state: StateEcho
    request: Message | None


@dataclass(frozen=True, slots=True)
class LinkSetup:
    """Sixteen bytes of the board's configuration, or a part on its 1-Wire."""

    answer: BlockPart | WirePart
    request: Message


@dataclass(frozen=True, slots=True)
class RequestRefused:
    """The board did not obey a request."""

    error: ErrorMessage
    request: Message


@dataclass(frozen=True, slots=True)
class RequestTimedOut:
    """A request that is given up; whether the board obeyed it is not known. It is not sent again."""

    request: Message


@dataclass(frozen=True, slots=True)
class Nonsense:
    """Frames that were damaged or meant nothing."""

    count: int


LinkEvent = (
    LinkUp
    | LinkLost
    | BoardReset
    | VersionRefused
    | Report
    | PairTold
    | LinkEcho
    | LinkSetup
    | RequestRefused
    | RequestTimedOut
    | Nonsense
)
