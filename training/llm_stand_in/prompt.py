"""Facts of a prompt of `assistant/llm/prompts.py`, read back from its text: the script's only input."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Message = Mapping[str, Any]
_NUMBER = r"(-?\d+(?:\.\d+)?)"
_BLOCK = re.compile(r'<data source="([^"]*)">\n(.*?)\n</data>', re.DOTALL)


@dataclass(frozen=True, slots=True)
class QuestionNumbers:
    """The numbers of one question; temperatures in degC."""

    target: float
    current: float
    ambient: float
    heater_max: float
    fan_on: bool
    fan_held: bool
    spare: bool
    steps: int  # longest set of controls for a simulation


def read_prompt(messages: Sequence[Message]) -> QuestionNumbers | None:
    """None for a prompt that is not a controller's."""
    text = "\n".join(str(message.get("content") or "") for message in messages[:2])
    numbers = [
        _find(pattern, text)
        for pattern in (
            rf"maintain a temperature of {_NUMBER}",
            rf"temperature now is {_NUMBER}",
            rf"ambient temperature is {_NUMBER}",
        )
    ]
    if None in numbers:
        return None
    target, current, ambient = (float(number) for number in numbers if number is not None)
    return QuestionNumbers(
        target=target,
        current=current,
        ambient=ambient,
        heater_max=float(_find(rf"heater_duty at most {_NUMBER}", text) or 1.0),
        fan_on="the fan is on" in text,
        fan_held="relay stays" in text,
        spare="spare heater and fan" in text,
        steps=int(_find(rf"A set has up to {_NUMBER} steps", text) or 1),
    )


def results(messages: Sequence[Message]) -> list[dict[str, Any]]:
    """Return the data blocks of all tool messages, oldest first: {"id", "result"}, or {"error"}."""
    blocks = [
        match[2]
        for message in messages
        if message.get("role") == "tool"
        for match in _BLOCK.finditer(str(message.get("content")))
    ]
    return [json.loads(block) for block in blocks]


def _find(pattern: str, text: str) -> str | None:
    match = re.search(pattern, text)
    return match[1] if match else None
