"""A rig's state as the database keeps it: the flat object of the topic `state`, checked."""

from typing import Any

from edge.core.names import SIGNALS
from edge.core.plain_text import plain, quote
from fleet.ingest.refusal import Refused
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
