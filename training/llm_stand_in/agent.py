"""The script behind the stand-in: it calls the tools it is offered and picks from what they say.

Each request holds the whole conversation, so the script has no memory of its own.
"""

import json
import random
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

from edge.core.names import HEATER_LEVELS
from training.llm_stand_in.gains import COMMON_SENSE, MinuteGains, estimate
from training.llm_stand_in.prompt import Asked, read_prompt, results
from training.llm_stand_in.wish import wish

SIMULATIONS = 6  # sets of controls that are tried
NEAR_K = 0.02  # a set this good needs no better one
FAN_FROM_K = 0.7  # above the target: worth to try the fan
EFFORT_K = 0.05  # of error that full heat and fan are worth where the prompt asks to spare them
QUERY = (
    "SELECT utc, step_s, estimate_temp_air_c, temp_ambient_c, heater_duty, fan_on FROM v_ticks "
    "ORDER BY utc DESC LIMIT 120"
)
Turn = dict[str, Any]  # an assistant's message


def reply(body: Mapping[str, Any], seed: int) -> Turn:
    """The next message of the conversation in `body`.

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
    """A message without calls."""
    return {"role": "assistant", "content": content}


def answers(duty: float, fan_on: bool, rationale: str, simulation: str | None = None) -> Turn:
    """The controls as JSON."""
    values: dict[str, Any] = {"heater_duty": duty, "fan_on": fan_on, "rationale": rationale}
    if simulation is not None:
        values["simulation"] = simulation
    return says(json.dumps(values))


def calls(name: str, arguments: Mapping[str, Any] | str, number: int) -> Turn:
    """A message that calls one tool."""
    text = arguments if isinstance(arguments, str) else json.dumps(arguments)
    call = {"id": f"call_{number}", "type": "function", "function": {"name": name, "arguments": text}}
    return {"role": "assistant", "content": None, "tool_calls": [call]}


def _by_gains(asked: Asked, gains: MinuteGains, jitter: int) -> Turn:
    """The duty that holds the target, and more or less to come there."""
    fan = asked.fan_on if asked.fan_held else asked.current - asked.target > 2 * FAN_FROM_K
    wanted = gains.duty(asked.target, asked.current, asked.ambient)
    duty = _level(wanted, asked, jitter)
    rationale = (
        f"The target is {asked.target:.2f} degC and the current temperature is {asked.current:.2f} degC."
    )
    return answers(duty, fan, rationale)


def _next_set(asked: Asked, simulated: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Constant heat: first by common sense, then where a straight line through the last two meets the target.

    Where the air is too hot even without heat, the fan too. None where that was tried already.
    """
    if _is_near(simulated):
        return None
    tried = [(each["result"]["heater_duty"][0], _mean_error(each)) for each in simulated]
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
        (each["result"]["heater_duty"][0], each["result"]["fan_on"][0]) == (level, fan) for each in simulated
    ):
        return None
    return {"heater_duty": [level] * asked.steps, "fan_on": [fan] * asked.steps}


def _secant(before: tuple[float, float], last: tuple[float, float]) -> float:
    slope = (last[1] - before[1]) / (last[0] - before[0]) if last[0] != before[0] else 0.0
    if not slope > 0.0:
        return last[0] + (1 if last[1] < 0.0 else -1) / HEATER_LEVELS
    return last[0] - last[1] / slope


def _best(asked: Asked, simulated: Sequence[Mapping[str, Any]], jitter: int) -> Turn:
    """The set with the least error, and effort where it is to be spared; a warmer model takes the second."""

    def price(each: Mapping[str, Any]) -> float:
        result = each["result"]
        effort = result["heater_duty"][0] + 2.0 * result["fan_on"][0]
        return float(result["mean_abs_error_k"]) + (EFFORT_K * effort if asked.spare else 0.0)

    best = sorted(simulated, key=price)[min(abs(jitter), len(simulated) - 1)]
    result = best["result"]
    rationale = f"The simulation {best['id']} shows {result['temp_air_c'][-1]:.2f} degC at its end."
    return answers(result["heater_duty"][0], result["fan_on"][0], rationale, best["id"])


def _mean_error(simulated: Mapping[str, Any]) -> float:
    result = simulated["result"]
    pairs = zip(result["temp_air_c"], result["target_c"], strict=True)
    return sum(temp - target for temp, target in pairs) / len(result["temp_air_c"])


def _is_near(simulated: Sequence[Mapping[str, Any]]) -> bool:
    return any(each["result"]["mean_abs_error_k"] < NEAR_K for each in simulated)


def _level(duty: float, asked: Asked, jitter: int) -> float:
    most = int(asked.heater_max * HEATER_LEVELS + 1e-9)
    level = min(max(round(duty * HEATER_LEVELS) + jitter, 0), most)
    return level / HEATER_LEVELS


def _jitter(body: Mapping[str, Any], seed: int) -> int:
    """Levels of heat beside the choice, as temperature would have it: none at 0."""
    if not body.get("temperature"):
        return 0
    text = json.dumps(body["messages"][:2], sort_keys=True)
    return random.Random(zlib.crc32(text.encode()) + seed).choice((-1, 0, 0, 1))
