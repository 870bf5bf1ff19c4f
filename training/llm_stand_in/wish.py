"""What the script makes of an operator's wish: numbers beside "day", "night" and "until", and a few words."""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

_WANTS = re.compile(r"The operator wants: (.*)", re.DOTALL)
_DAY = re.compile(r"Day is (\d\d:\d\d) to (\d\d:\d\d)")
_BY = re.compile(
    r"(\d+(?:\.\d+)?)\s*(?:°C|degrees|degc)?\s*(?:by|at|during|in the)\s*(day|night)", re.IGNORECASE
)
_PLAIN = re.compile(r"(?:keep|hold|set|at|to)\s*(\d+(?:\.\d+)?)", re.IGNORECASE)
_HOURS = re.compile(r"for\s*(\d+(?:\.\d+)?)\s*h", re.IGNORECASE)
_EASY = re.compile(r"(?:go easy on|spare|save|less)\s*(?:the|of the)?\s*(fan|heater|heat)", re.IGNORECASE)
_NO_FAN = re.compile(r"no fan (?:at|by|in the) night", re.IGNORECASE)
_MOST = re.compile(r"at most (\d+)\s*%", re.IGNORECASE)


def wish(messages: Sequence[Mapping[str, Any]]) -> str | None:
    """The answer to an operator's wish; None where the conversation holds none."""
    said = [str(message.get("content")) for message in messages] or [""]
    wanted, clock = _WANTS.search(said[-1]), _DAY.search(said[0])
    return None if wanted is None or clock is None else json.dumps(_settings(wanted[1], *clock.groups()))


def _settings(words: str, day: str, night: str) -> dict[str, Any]:
    begins = {"day": day, "night": night}
    reference = [{"from": begins[when.lower()], "degc": float(temp)} for temp, when in _BY.findall(words)]
    if not reference and (plain := _PLAIN.search(words)):
        reference = [{"from": "00:00", "degc": float(plain[1])}]
    easy = {what.lower() for what in _EASY.findall(words)}
    most, hours = _MOST.search(words), _HOURS.search(words)
    settings = {
        "reference": sorted(reference, key=lambda item: str(item["from"])),
        "heater_penalty": 5.0 if easy & {"heater", "heat"} else None,
        "fan_penalty": 5.0 if "fan" in easy else None,
        "heater_max_duty": float(most[1]) / 100.0 if most else None,
        "fan_rest": [{"from": night, "until": day}] if _NO_FAN.search(words) else [],
        "hours": float(hours[1]) if hours else 24.0,
    }
    understood = any(settings[key] for key in settings if key != "hours")
    question = "" if understood else "Which temperature do you want, and when?"
    return {**settings, "understood": f"What I read in: {words[:200]}", "question": question}
