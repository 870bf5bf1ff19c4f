"""The controller `external`: another process proposes, `edge/sockets/external_proposals.py` asks it."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Protocol

from edge.core.controller import Context
from edge.core.controller_names import EXTERNAL
from edge.core.errors import RequestError
from edge.core.messages import Command, Decision
from edge.core.names import HEATER_LEVELS
from edge.core.plain_text import shown
from edge.models.policy_observation import by_name, observe_tick

WHY_MAX = 2000  # of a client's own reasons; longer ones are left out of the history [bytes of JSON]


class Proposals(Protocol):
    """Who is asked."""

    def ask(self, question: Mapping[str, Any], deadline_s: float) -> dict[str, Any]: ...


class External:
    """Passes on what a client proposes for this tick; raises where it proposes nothing that can be meant."""

    name = EXTERNAL

    def __init__(self, proposals: Proposals, deadline_s: float) -> None:
        self._proposals = proposals
        self._deadline_s = deadline_s
        self._tick = 0
        self._proposed: dict[str, Any] | None = None  # for the tick before

    def reset(self) -> None:
        """Drop proposals from before another controller decided."""
        self._proposed = None

    def decide(self, context: Context) -> Decision:
        """Return the client's command. Raises: DataError for an observation with holes; RequestError"""
        self._tick += 1
        question = self._question(context)
        self._proposed = None
        answer = self._proposals.ask(question, self._deadline_s)
        command = _command(answer)
        self._proposed = {"heater_duty": command.heater_duty, "fan_on": command.fan_on}
        why = {"tick": self._tick, "reference_c": question["reference_c"]}
        said = answer.get("why")
        return Decision(command, self.name, why=why if said is None else {**why, "client": _kept(said)})

    def _question(self, context: Context) -> dict[str, Any]:
        observation, sent = observe_tick(context), context.last_sent
        return {
            "tick": self._tick,
            "time_s": context.now_s,
            "observation": by_name(observation),
            "features": observation.tolist(),
            "reference_c": float(context.reference[0]),
            "temp_air_c": context.estimate.temp_air,
            "temp_ambient_c": context.estimate.temp_ambient,
            "limits": asdict(context.limits),
            "last_sent": {"heater_duty": sent.heater_duty, "fan_on": sent.fan_on},
            "previous": self._proposed,
        }


def _command(answer: Mapping[str, Any]) -> Command:
    """Errors: RequestError for what is no duty or no state of a relay"""
    duty, fan_on = answer.get("heater_duty"), answer.get("fan_on")
    if isinstance(duty, bool) or not isinstance(duty, int | float) or not 0.0 <= duty <= 1.0:
        raise RequestError(f"heater_duty: {shown(duty)} is not a number from 0 to 1")
    if not isinstance(fan_on, bool):
        raise RequestError(f"fan_on: {shown(fan_on)} is neither true nor false")
    return Command(heater_duty=round(duty * HEATER_LEVELS) / HEATER_LEVELS, fan_on=fan_on)


def _kept(said: Any) -> Any:
    """Return a client's reason as the history can store it: 1e999 is infinite, "\\ud800" is not text."""
    try:
        size = len(json.dumps(said, allow_nan=False, ensure_ascii=False).encode())
    except (ValueError, RecursionError):
        return "not fit to be kept"
    return said if size <= WHY_MAX else "too long to keep"
