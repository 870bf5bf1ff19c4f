"""The script behind the stand-in: it calls the tools it is offered and picks from what they say.

Each request holds the whole conversation, so the script has no memory of its own.
"""

import json
import math
import random
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge.core.names import HEATER_LEVELS

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
    )


def results(messages: Sequence[Message]) -> list[dict[str, Any]]:
    """Return the data blocks of all tool messages: {"id", "result", "arguments"}, or {"error"}."""
    asked = {
        call["id"]: call["function"]["arguments"]
        for message in messages
        for call in message.get("tool_calls") or ()
    }
    return [
        json.loads(match[2]) | {"arguments": json.loads(asked[message["tool_call_id"]])}
        for message in messages
        if message.get("role") == "tool"
        for match in _BLOCK.finditer(str(message.get("content")))
    ]


def _find(pattern: str, text: str) -> str | None:
    match = re.search(pattern, text)
    return match[1] if match else None


SIMULATIONS = 6  # sets of controls that are tried
NEAR_K = 0.02  # a set this good needs no better one
FAN_FROM_K = 0.7  # above the target: worth to try the fan
EFFORT_K = 0.05  # of error that full heat and fan are worth where the prompt asks to spare them
QUERY = (
    "SELECT utc, step_s, estimate_temp_air_c, temp_ambient_c, heater_duty, fan_on FROM v_ticks "
    "ORDER BY utc DESC LIMIT 120"
)
Turn = dict[str, Any]  # an assistant's message


ROWS_MIN = 15
REACH_MIN = 5.0  # an error shall be gone after about so long


@dataclass(frozen=True, slots=True)
class MinuteGains:
    """Gains of a minute: the share of its excess over the room that air
    loses, and the rise by full heat [K].
    """

    loss: float
    heat: float

    def duty(self, target: float, current: float, ambient: float) -> float:
        """Return the duty that holds the target and brings the air there."""
        return (self.loss * (target - ambient) + (target - current) / REACH_MIN) / self.heat


COMMON_SENSE = MinuteGains(loss=0.05, heat=1.0)  # 100 W hold such a box about 20 K above its room


def estimate(result: Mapping[str, Any]) -> MinuteGains:
    """From the rows of `agent.QUERY`, newest first; common sense where they tell too little."""
    rows = [row for row in result["rows"] if None not in row][::-1]
    if len(rows) < ROWS_MIN:
        return COMMON_SENSE
    _, step_s, air, ambient, duty, fan = np.array(rows, dtype=float).T
    minutes = step_s[:-1] / 60.0
    rise, excess = np.diff(air) / minutes, (air - ambient)[:-1]
    terms = np.column_stack([-excess, duty[:-1], -excess * fan[:-1]])
    gains, *_ = np.linalg.lstsq(terms, rise, rcond=None)
    loss, heat = float(gains[0]), float(gains[1])
    plausible = math.isfinite(loss + heat) and 0.005 < loss < 0.5 and 0.1 < heat < 10.0
    return MinuteGains(loss, heat) if plausible else COMMON_SENSE


def reply(body: Mapping[str, Any], seed: int) -> Turn:
    """Return the next message of the conversation in `body`.

    seed : of the jitter at temperature 1, together with the prompt
    """
    messages = body["messages"]
    asked = read_prompt(messages)
    if asked is None:
        return says(wish(messages) or "I can only choose controls of a greenhouse.")
    jitter = _jitter(body, seed)
    offered = {tool["function"]["name"] for tool in body.get("tools", ())}
    found = [each for each in results(messages) if "result" in each]
    simulated = [each for each in found if each["id"].startswith("simulate")]
    following = _next_set(asked, simulated) if len(simulated) < SIMULATIONS else None
    if "simulate" in offered and following:
        return calls("simulate", following, len(messages))
    if simulated:
        return _best(asked, simulated, jitter)
    if "sql" in offered and not found:
        return calls("sql", {"query": QUERY}, len(messages))
    gains = estimate(found[-1]["result"]) if found else COMMON_SENSE
    return _by_gains(asked, gains, jitter)


def says(content: str | None) -> Turn:
    """Return a message without calls."""
    return {"role": "assistant", "content": content}


def answers(duty: float, fan_on: bool, rationale: str, simulation: str | None = None) -> Turn:
    """Return the controls as JSON."""
    values: dict[str, Any] = {"heater_duty": duty, "fan_on": fan_on, "rationale": rationale}
    if simulation is not None:
        values["simulation"] = simulation
    return says(json.dumps(values))


def calls(name: str, arguments: Mapping[str, Any] | str, number: int) -> Turn:
    """Return a message that calls one tool."""
    text = arguments if isinstance(arguments, str) else json.dumps(arguments)
    call = {"id": f"call_{number}", "type": "function", "function": {"name": name, "arguments": text}}
    return {"role": "assistant", "content": None, "tool_calls": [call]}


def _by_gains(asked: QuestionNumbers, gains: MinuteGains, jitter: int) -> Turn:
    """Return the duty that holds the target, more or less of it while the air is away from it."""
    fan = asked.fan_on if asked.fan_held else asked.current - asked.target > 2 * FAN_FROM_K
    wanted = gains.duty(asked.target, asked.current, asked.ambient)
    duty = _level(wanted, asked, jitter)
    rationale = (
        f"The target is {asked.target:.2f} degC and the current temperature is {asked.current:.2f} degC."
    )
    return answers(duty, fan, rationale)


def _next_set(asked: QuestionNumbers, simulated: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Constant heat: first by common sense, then where a straight line through the last two meets the target.

    Where the air is too hot even without heat, the fan too. None where that was tried already.
    """
    if _is_near(simulated):
        return None
    tried = [(each["arguments"]["heater_duty"][0], _mean_error(each, asked.target)) for each in simulated]
    fan = asked.fan_held and asked.fan_on
    if not tried:
        duty = COMMON_SENSE.duty(asked.target, asked.current, asked.ambient)
    elif not asked.fan_held and min(tried)[0] == 0.0 and min(tried)[1] > FAN_FROM_K:
        duty, fan = 0.05 * (len(tried) - 1), True
    elif len(tried) == 1:
        duty = tried[0][0] - 0.1 * (1 if tried[0][1] > 0.0 else -1)
    else:
        duty = _secant(tried[-2], tried[-1])
    level = _level(duty, asked, 0)
    if any(
        (each["arguments"]["heater_duty"][0], each["arguments"]["fan_on"][0]) == (level, fan)
        for each in simulated
    ):
        return None
    return {"heater_duty": [level], "fan_on": [fan]}


def _secant(before: tuple[float, float], last: tuple[float, float]) -> float:
    slope = (last[1] - before[1]) / (last[0] - before[0]) if last[0] != before[0] else 0.0
    if not slope > 0.0:
        return last[0] + (1 if last[1] < 0.0 else -1) / HEATER_LEVELS
    return last[0] - last[1] / slope


def _best(asked: QuestionNumbers, simulated: Sequence[Mapping[str, Any]], jitter: int) -> Turn:
    """Return the set with the least error, and effort where it costs; a warmer model takes the second."""

    def price(each: Mapping[str, Any]) -> float:
        controls = each["arguments"]
        effort = controls["heater_duty"][0] + 2.0 * controls["fan_on"][0]
        return float(each["result"]["mean_abs_error_k"]) + (EFFORT_K * effort if asked.spare else 0.0)

    best = sorted(simulated, key=price)[min(abs(jitter), len(simulated) - 1)]
    controls, ends_c = best["arguments"], best["result"]["temp_air_c"][-1]
    rationale = f"The simulation {best['id']} shows {ends_c:.2f} degC at its end."
    return answers(controls["heater_duty"][0], controls["fan_on"][0], rationale, best["id"])


def _mean_error(simulated: Mapping[str, Any], target: float) -> float:
    temps = simulated["result"]["temp_air_c"]
    return float(sum(temp - target for temp in temps) / len(temps))


def _is_near(simulated: Sequence[Mapping[str, Any]]) -> bool:
    return any(each["result"]["mean_abs_error_k"] < NEAR_K for each in simulated)


def _level(duty: float, asked: QuestionNumbers, jitter: int) -> float:
    most = int(asked.heater_max * HEATER_LEVELS + 1e-9)
    level = min(max(round(duty * HEATER_LEVELS) + jitter, 0), most)
    return level / HEATER_LEVELS


def _jitter(body: Mapping[str, Any], seed: int) -> int:
    """Levels of heat beside the choice, as temperature would have it: none at 0."""
    if not body.get("temperature"):
        return 0
    text = json.dumps(body["messages"][:2], sort_keys=True)
    return random.Random(zlib.crc32(text.encode()) + seed).choice((-1, 0, 0, 1))


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
    """Return the answer to an operator's request, None where the conversation holds none."""
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
