"""Commands from the broker: text in, Request out. Pure and strict; what passes still goes through safety."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from edge.bundle import remote
from edge.bundle.manifest import Sha256, Version
from edge.config.settings import ReferenceSettings
from edge.core.controller_names import CONTROLLERS
from edge.core.errors import RequestError
from edge.core.hard_limits import MAINTENANCE_MAX_MIN
from edge.core.stop_words import asks_to_stop
from edge.formats.cross_check import CheckedDocument, Rule
from edge.formats.reader import DocumentError, parse_json, read
from edge.tick.orders import FanMode, Mode, SetManual

Request = dict[str, Any]

STOP = "emergency_stop"
WORDED, WORDS_MAX = ("mode", "ask"), 40  # where a person may say "stop", and in how many bytes
PAYLOAD_MAX = 1024  # [bytes]
SEQ_MAX = 2**63 - 1  # SQLite's largest integer
Seq = Annotated[int, Rule(low=1, high=SEQ_MAX)]
NO_PRESET = "none"
PRESS = "PRESS"  # what a Home Assistant button sends
ON, OFF = "ON", "OFF"  # what its switches send
_NUMBER = re.compile(r"-?[0-9]{1,12}(\.[0-9]{1,12})?")  # no "nan", no "1_0", no digits of other scripts


@dataclass(frozen=True, slots=True)
class Resend(CheckedDocument):
    """Keys of the request to queue recorded ticks again."""

    first_seq: Seq
    last_seq: Seq

    def cross_check(self) -> None:
        """Check that the span is not backwards."""
        if self.last_seq < self.first_seq:
            self.refuse("last_seq", f"{self.last_seq} is before first_seq, {self.first_seq}")


@dataclass(frozen=True, slots=True)
class RemoteInstall:
    """Keys of a fleet's order to install a bundle; the keeper of bundles says whether it is obeyed."""

    url: Annotated[str, Rule(least=1)]
    sha256: Sha256


@dataclass(frozen=True, slots=True)
class RemoteRollback:
    """Keys of a fleet's order to leave a bundle."""

    version: Version


def parse(what: str, payload: bytes, reference: ReferenceSettings) -> Request:
    """Return the request that `payload` on the topic `set/<what>` means.

    reference : gives the range of temperatures an operator may ask for
    Errors : RequestError with a text for the sender
    """
    if what == STOP:
        return _stop(payload)
    parser = _PARSERS.get(what)
    if parser is None:
        raise RequestError(f"unknown command; known: {', '.join(COMMANDS)}")
    if len(payload) > PAYLOAD_MAX:
        raise RequestError(f"payload is longer than {PAYLOAD_MAX} bytes")
    if is_stop_in_words(what, payload):
        return {"do": STOP}
    try:
        text = payload.decode()
    except UnicodeDecodeError:
        raise RequestError("payload is not UTF-8") from None
    return parser(text, reference)


def _mode(text: str, reference: ReferenceSettings) -> Request:
    return {"do": "set_mode", "mode": _choice(text, tuple(mode.value for mode in Mode))}


def _fan_mode(text: str, reference: ReferenceSettings) -> Request:
    return {"do": "set_fan_mode", "fan_mode": _choice(text, tuple(mode.value for mode in FanMode))}


def _temperature(text: str, reference: ReferenceSettings) -> Request:
    return {"do": "set_reference", "reference_c": _number(text, reference.min_c, reference.max_c)}


def _controller(text: str, reference: ReferenceSettings) -> Request:
    """`none`, which Home Assistant sends to clear a preset, asks for the configured controller."""
    name = None if text == NO_PRESET else _choice(text, CONTROLLERS)
    return {"do": "set_controller", "name": name}


def _manual(text: str, reference: ReferenceSettings) -> Request:
    values = _values(SetManual, text)
    if not values:
        raise RequestError("payload must hold heater_duty, fan_on or led")
    return {"do": "set_manual", **values}


def _install_bundle(text: str, reference: ReferenceSettings) -> Request:
    return {"do": "bundle", "action": remote.INSTALL, **_values(RemoteInstall, text)}


def _rollback_bundle(text: str, reference: ReferenceSettings) -> Request:
    return {"do": "bundle", "action": remote.ROLL_BACK, **_values(RemoteRollback, text)}


def _stop(payload: bytes) -> Request:
    """`OFF` releases, so that one switch does both; `release_emergency_stop` does it too."""
    if not payload:
        raise RequestError("an empty payload, as clearing a retained topic sends it: nothing was stopped")
    return {"do": STOP} if is_stop(payload) else {"do": "release_emergency_stop"}


def is_stop(payload: bytes) -> bool:
    """Return whether a payload on the stop's topic asks for a stop; one that is not understood does."""
    return payload not in (b"", OFF.encode())


def is_stop_in_words(what: str, payload: bytes) -> bool:
    """Return whether a payload on another topic asks for a stop and nothing else."""
    is_short = what in WORDED and len(payload) <= WORDS_MAX
    return is_short and asks_to_stop(payload.decode(errors="replace"))


def _on_proposal(do: str) -> Callable[[str, ReferenceSettings], Request]:
    def parse_id(text: str, reference: ReferenceSettings) -> Request:
        if not text:  # from the buttons of Home Assistant, see `discovery`
            raise RequestError("no proposal is named: there is none, or it has changed this second; read it")
        return {"do": do, "id": text}

    return parse_id


def _discard(text: str, reference: ReferenceSettings) -> Request:
    """Return the request; after the id and a blank an operator may say why."""
    id, _, why = text.partition(" ")
    request = _on_proposal("discard")(id, reference)
    return {**request, "why": why.strip()} if why.strip() else request


def _why(text: str, reference: ReferenceSettings) -> Request:
    """Return the request for an explanation; an empty payload asks for the newest command."""
    if not text:
        return {"do": "why", "at_utc": None}
    if not _NUMBER.fullmatch(text):
        raise RequestError(f"{_quote(text)} is no time in seconds since 1970; empty is now")
    return {"do": "why", "at_utc": float(text)}


def _press(request: Request) -> Callable[[str, ReferenceSettings], Request]:
    def parse_press(text: str, reference: ReferenceSettings) -> Request:
        _choice(text, (PRESS,))
        return dict(request)

    return parse_press


def _choice(text: str, known: tuple[str, ...]) -> str:
    if text not in known:
        raise RequestError(f"{_quote(text)} is not one of {', '.join(known)}")
    return text


def _number(text: str, low: float, high: float) -> float:
    if not _NUMBER.fullmatch(text) or not low <= float(text) <= high:
        raise RequestError(f"{_quote(text)} is not a number from {low:g} to {high:g}")
    return float(text)


def _values(kind: type, text: str) -> dict[str, Any]:
    """Return the payload's keys after a check that they are those of a `kind`."""
    try:
        values = parse_json(text, "payload")
        read(kind, values, "payload")
    except DocumentError as error:
        raise RequestError(str(error)) from None
    return values


def _quote(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:40]}...")


_PARSERS: Mapping[str, Callable[[str, ReferenceSettings], Request]] = {
    "mode": _mode,
    "temperature": _temperature,
    "fan_mode": _fan_mode,
    "controller": _controller,
    "manual": _manual,
    "maintenance": lambda text, reference: {
        "do": "maintenance",
        "minutes": _number(text, 0.0, MAINTENANCE_MAX_MIN),
    },
    "resend": lambda text, reference: {"do": "resend", **_values(Resend, text)},
    "release_emergency_stop": _press({"do": "release_emergency_stop"}),
    "clear_trip": _press({"do": "clear_trip"}),
    "follow_schedule": _press({"do": "set_reference", "reference_c": None}),
    "commission": _press({"do": "commission"}),
    "end_commissioning": _press({"do": "commission", "end": True}),
    "status": _press({"do": "status"}),
    "ask": lambda text, reference: {"do": "ask", "words": text},
    "confirm": _on_proposal("confirm"),
    "discard": _discard,
    "undo": _press({"do": "undo"}),
    "why": _why,
    "install_bundle": _install_bundle,
    "rollback_bundle": _rollback_bundle,
}
COMMANDS = (STOP, *_PARSERS)
