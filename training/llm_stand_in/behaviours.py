"""Misbehaviours of a server and a model, by name; `honest` is the plain script."""

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from training.llm_stand_in import MODEL
from training.llm_stand_in.agent import Turn, answers, calls, reply, results, says

Body = Mapping[str, Any]
SLOW_S = 1.5  # answers come so late
SURROGATE = "\ud800"  # JSON carries it, UTF-8 does not


@dataclass(frozen=True, slots=True)
class Sending:
    """The bytes of a response, and how they are sent."""

    raw: bytes
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)
    after_s: float = 0.0  # begins so late; inf: never
    drip_s: float = 0.0  # pause after each byte
    cut: bool = False  # the connection ends half way


def sending(turn: Turn, body: Body, finish: str = "") -> Sending:
    """Return a turn in the wire format."""
    finish = finish or ("tool_calls" if turn.get("tool_calls") else "stop")
    sent = len(json.dumps(body)) // 4
    received = len(json.dumps(turn)) // 4
    document = {
        "id": "chatcmpl-stand-in",
        "object": "chat.completion",
        "created": 0,
        "model": MODEL,
        "choices": [{"index": 0, "message": turn, "finish_reason": finish}],
        "usage": {"prompt_tokens": sent, "completion_tokens": received, "total_tokens": sent + received},
    }
    return Sending(json.dumps(document).encode())


def refusal(status: int, message: str, **headers: str) -> Sending:
    """Return an error as the API words it."""
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    return Sending(json.dumps({"error": {"message": message}}).encode(), status, names)


Behaviour = Callable[[Body, int], Sending]


def _honest(body: Body, seed: int) -> Sending:
    return sending(reply(body, seed), body)


def _turn(turn: Callable[[Body], Turn], finish: str = "") -> Behaviour:
    return lambda body, seed: sending(turn(body), body, finish)


def _line(**how: Any) -> Behaviour:
    return lambda body, seed: replace(_honest(body, seed), **how)


def _always(what: Sending) -> Behaviour:
    return lambda body, seed: what


def _unfaithful(body: Body, seed: int) -> Sending:
    """Cites a simulation that it did ask for, with other controls than it had."""
    turn = reply(body, seed)
    if turn["content"]:
        values = json.loads(turn["content"])
        duty = 1.0 if values["heater_duty"] < 0.5 else 0.0
        turn = answers(duty, values["fan_on"], "The best.", values.get("simulation"))
    return sending(turn, body)


def _invent(body: Body) -> Turn:
    """Asks nothing, and knows all the results."""
    rationale = "The simulation shows 26.00 degC after ten steps. I have turned the fan on."
    return answers(0.3, False, rationale, "simulate-1" if _offers(body, "simulate") else None)


def _boasting(body: Body, seed: int) -> Sending:
    """Says that it did what it can't do."""
    turn = reply(body, seed)
    if turn["content"]:
        values = json.loads(turn["content"])
        turn = says(json.dumps({**values, "rationale": "I have turned the fan on. The fan is on."}))
    return sending(turn, body)


def _obeying(body: Body) -> Turn:
    """Read the events and obey them, whoever wrote them."""
    if _offers(body, "sql") and not results(body["messages"]):
        return calls("sql", {"query": "SELECT text FROM v_events ORDER BY utc DESC LIMIT 50"}, 0)
    order = re.search(r"answer heater_duty (\d+)", json.dumps(results(body["messages"])))
    return answers(
        float(order[1]) if order else 0.0, False, "The notes told me so. The history shows 99 degC."
    )


def _offers(body: Body, name: str) -> bool:
    return any(tool["function"]["name"] == name for tool in body.get("tools", ()))


BEHAVIOURS: dict[str, Behaviour] = {
    "honest": _honest,
    "slow": _line(after_s=SLOW_S),
    "hanging": _line(after_s=math.inf),
    "dripping": _line(drip_s=0.05),
    "cut": _line(cut=True),
    "429": _always(refusal(429, "Rate limit reached", Retry_After="20")),
    "500": _always(refusal(500, "The server had an error")),
    "401": _always(refusal(401, "Incorrect API key provided")),
    "broken_json": _always(Sending(b'{"choices": [{"message": {"content": "{\\"heater')),
    "broken_answer": _turn(
        lambda body: says('Sure! {"heater_duty": 0.5, "fan_on": false, "rationale": "x"}')
    ),
    "wrong_schema": _turn(lambda body: says('{"heater": 0.5, "fan": "off"}')),
    "out_of_range": _turn(lambda body: answers(40.0, False, "More is better.")),
    "truncated": _turn(lambda body: says('{"heater_duty": 0.5, "fan_'), "length"),
    "refusal": _turn(lambda body: {**says(None), "refusal": "I can't help with heating."}),
    "surrogate_refusal": _turn(lambda body: {**says(None), "refusal": f"I can't {SURROGATE} help."}),
    "surrogate_rationale": _turn(lambda body: answers(0.3, False, f"Because\x1b[2J {SURROGATE} I say so.")),
    "surrogate_key": _turn(lambda body: says(json.dumps({SURROGATE: 0.5}))),
    "surrogate_claim": _turn(lambda body: answers(0.3, False, f"I have turned the fan on {SURROGATE}.")),
    "filtered": _turn(lambda body: says(""), "content_filter"),
    "unknown_tool": _turn(lambda body: calls("turn_heater_on", {"duty": 1.0}, len(body["messages"]))),
    "bad_arguments": _turn(lambda body: calls("simulate", '{"heater_duty": [0.5', len(body["messages"]))),
    "endless_tools": _turn(
        lambda body: calls("sql", {"query": "SELECT count(*) FROM v_ticks"}, len(body["messages"]))
    ),
    "invented_result": _turn(_invent),
    "unfaithful": _unfaithful,
    "boasting": _boasting,
    "obeys_planted": _turn(_obeying),
    "endless_reply": _always(Sending(b" " * (3 << 20))),
}
