"""Answer of a language model to an operator's request: its form, and
the check that makes a Steering of it.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from edge.config.settings import ReferenceSettings
from edge.core.errors import RequestError
from edge.core.plain_text import plain, shown
from edge.tick.steering import HOURS_MAX, PENALTY_MAX, DailyTarget, FanRest, Steering

TARGETS_MAX = 24
RESTS_MAX = 12
TEXT_MAX = 600  # longer words of a model are cut
_CLOCK = re.compile(r"([01]\d|2[0-3]):([0-5]\d)", re.ASCII)

_NUMBER_OR_NULL = {"type": ["number", "null"]}
_CLOCK_TEXT = {"type": "string", "pattern": "^([01][0-9]|2[0-3]):[0-5][0-9]$"}


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


SCHEMA = _object(
    {
        "reference": {
            "type": "array",
            "items": _object({"from": _CLOCK_TEXT, "degc": {"type": "number"}}),
        },
        "heater_penalty": _NUMBER_OR_NULL,
        "fan_penalty": _NUMBER_OR_NULL,
        "heater_max_duty": _NUMBER_OR_NULL,
        "fan_rest": {"type": "array", "items": _object({"from": _CLOCK_TEXT, "until": _CLOCK_TEXT})},
        "hours": {"type": "number"},
        "understood": {"type": "string"},
        "question": {"type": "string"},
    }
)


@dataclass(frozen=True, slots=True)
class Understood:
    """A steering, or a question to the operator. `text` is the model's own wording."""

    steering: Steering | None
    text: str
    question: str


def understood(
    document: Mapping[str, Any], id: str, words: str, now_utc: float, limits: ReferenceSettings
) -> Understood:
    """Return the model's answer as a steering within the rig's limits.

    Errors : RequestError that names the key
    """
    keys = SCHEMA["required"]
    if odd := sorted(set(keys) ^ set(document)):
        raise RequestError(f"{plain(odd[0], 40)}: {'missing' if odd[0] in keys else 'unknown key'}")
    steering = Steering(
        id=id,
        words=words,
        until_utc=now_utc + 3600.0 * _number(document, "hours", 0.1, HOURS_MAX),
        daily=_daily(document["reference"], limits),
        heater_penalty=_number_or_none(document, "heater_penalty", PENALTY_MAX),
        fan_penalty=_number_or_none(document, "fan_penalty", PENALTY_MAX),
        heater_max_duty=_number_or_none(document, "heater_max_duty", 1.0),
        fan_rest=_rests(document["fan_rest"]),
    )
    text, question = (_text(document, key) for key in ("understood", "question"))
    if question or _asks_for_nothing(steering):
        return Understood(None, text, question or "What shall be different? Nothing was understood.")
    return Understood(steering, text, "")


def _asks_for_nothing(steering: Steering) -> bool:
    values = (steering.heater_penalty, steering.fan_penalty, steering.heater_max_duty)
    return not steering.daily and not steering.fan_rest and all(value is None for value in values)


def _daily(items: Any, limits: ReferenceSettings) -> tuple[DailyTarget, ...]:
    targets = tuple(
        DailyTarget(_clock(item, "from", place), _number(item, "degc", limits.min_c, limits.max_c, place))
        for place, item in _items(items, "reference", ("from", "degc"), TARGETS_MAX)
    )
    if any(not a.from_s < b.from_s for a, b in pairwise(targets)):
        raise RequestError("reference: the times must rise from one to the next, each once")
    return targets


def _rests(items: Any) -> tuple[FanRest, ...]:
    rests = tuple(
        FanRest(_clock(item, "from", place), _clock(item, "until", place))
        for place, item in _items(items, "fan_rest", ("from", "until"), RESTS_MAX)
    )
    if any(rest.from_s == rest.until_s for rest in rests):
        raise RequestError("fan_rest: begins and ends at one time: heater_max_duty and the fan mode do that")
    return rests


def _items(items: Any, key: str, keys: tuple[str, ...], most: int) -> list[tuple[str, Mapping[str, Any]]]:
    if not isinstance(items, list) or len(items) > most:
        raise RequestError(f"{key}: must be a list of at most {most}")
    for index, item in enumerate(items):
        if not isinstance(item, dict) or set(item) != set(keys):
            raise RequestError(f"{key}[{index}]: must hold {' and '.join(keys)}")
    return [(f"{key}[{index}].", item) for index, item in enumerate(items)]


def _clock(item: Mapping[str, Any], key: str, place: str) -> float:
    value = item[key]
    found = _CLOCK.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        raise RequestError(f"{place}{key}: {shown(value)} is no local time like 06:00")
    return 3600.0 * int(found[1]) + 60.0 * int(found[2])


def _number(item: Mapping[str, Any], key: str, low: float, high: float, place: str = "") -> float:
    value = item[key]
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not number or not low <= value <= high:
        raise RequestError(f"{place}{key}: {shown(value)} is not a number from {low:g} to {high:g}")
    return float(value)


def _number_or_none(item: Mapping[str, Any], key: str, high: float) -> float | None:
    return None if item[key] is None else _number(item, key, 0.0, high)


def _text(document: Mapping[str, Any], key: str) -> str:
    value = document[key]
    if not isinstance(value, str):
        raise RequestError(f"{key}: {shown(value)} is no text")
    return plain(value, TEXT_MAX)
