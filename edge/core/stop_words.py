"""Wordings of an emergency stop: whoever gives one is in a hurry."""

import re
from collections.abc import Mapping
from typing import Any

_STOP_WORDS = ("stop", "emergencystop", "estop", "stopnow", "stopeverything", "halt")
_STOP_KEYS = {"ask": ("words",), "set_mode": ("mode",)}  # where else a person may say it


def asks_to_stop(text: object) -> bool:
    """Return whether a text asks for a stop and nothing else: "stop", "Emergency Stop!", "e-stop"."""
    return isinstance(text, str) and re.sub("[^a-z]", "", text.lower()) in _STOP_WORDS


def as_stop(request: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return an emergency stop for a request that asks for one in any wording, else the request itself.

    Further keys do not make a stop invalid: only its author counts.
    """
    if any(asks_to_stop(request.get(key)) for key in _STOP_KEYS.get(str(request.get("do")), ("do",))):
        return {key: request[key] for key in ("by",) if key in request} | {"do": "emergency_stop"}
    return request
