"""Readers of what a rig says of itself: its state, and its twin as a file of a twin is read."""

import re
from dataclasses import dataclass
from typing import Any

from edge.bundle.manifest import FILE_NAME
from edge.core.errors import DataError
from edge.core.names import SIGNALS
from edge.core.plain_text import plain, quote
from edge.twin.twin_file import twin_of
from fleet.ingest.spans import Refused
from fleet.ingest.tick import SEQ_MAX, VALUE_MAX, parse_body

KEYS_MAX = 200
TEXT_MAX = 1000


def parse_state(payload: bytes) -> dict[str, Any]:
    """Return the state. Errors: Refused"""
    state = parse_body(payload)
    if len(state) > KEYS_MAX:
        raise Refused("value", f"state: more than {KEYS_MAX} keys")
    seq = state.get("seq")
    if type(seq) is not int or not 0 <= seq <= SEQ_MAX:
        raise Refused("seq", f"state: seq: {quote(seq)} is not a number of a tick")
    for signal in SIGNALS.values():
        value = state.get(signal.key)
        if value is not None and (type(value) not in (int, float) or not -VALUE_MAX <= value <= VALUE_MAX):
            raise Refused("value", f"state: {signal.key}: {quote(value)} is not a number")
    return {plain(key, 64): _value(key, value) for key, value in state.items()}


def _value(key: str, value: Any) -> Any:
    if isinstance(value, str):
        return plain(value, TEXT_MAX)
    if value is None or isinstance(value, int | float):
        return value
    raise Refused("value", f"state: {plain(key, 40)}: is not a number or a text")


@dataclass(frozen=True, slots=True)
class HeardTwin:
    """The payload of the topic `twin`. document : of a twin file"""

    bundle: str
    document: dict[str, Any]


def parse_twin(payload: bytes) -> HeardTwin | None:
    """Return the twin, None for a rig that takes it back. Errors: Refused"""
    if not payload:
        return None
    body = parse_body(payload)
    bundle, document = body.get("bundle"), body.get("twin")
    if not isinstance(bundle, str) or not re.fullmatch(FILE_NAME, bundle) or not isinstance(document, dict):
        raise Refused("value", f"twin: {quote(bundle)} is no bundle's name, or there is no twin")
    try:
        twin_of(document)
    except DataError as error:
        raise Refused("value", f"twin: {plain(str(error))}") from None
    return HeardTwin(bundle, document)
