"""The controller `external`: another process proposes, `edge/sockets/external_proposals.py` asks it."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Protocol

from edge.core.controller import Context
from edge.core.controller_names import EXTERNAL
from edge.core.errors import RequestError
from edge.core.messages import Command, Decision
from edge.core.names import HEATER_LEVELS
from edge.formats.cross_check import Rule
from edge.formats.reader import DocumentError, read
from edge.models.policy_observation import by_name, observe_tick

WHY_MAX = 2000  # of a client's own reasons; longer ones are left out of the history [bytes of JSON]


@dataclass(frozen=True, slots=True)
class Proposal:
    """A client's answer; the tick was looked at where it came in."""

    heater_duty: Annotated[float, Rule(low=0.0, high=1.0)]
    fan_on: bool
    tick: Any = None
    why: Any = None


class Proposals(Protocol):
    """Who is asked."""

    def ask(self, question: Mapping[str, Any], deadline_s: float) -> dict[str, Any]:
        """Return the client's JSON object. Errors: RequestError when none arrives within `deadline_s`."""
        ...


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
        """Return the client's command, its duty rounded to a level of the heater.

        Errors : DataError for an observation with holes; RequestError without a valid proposal in time
        """
        self._tick += 1
        question = self._question(context)
        self._proposed = None
        answer = self._proposals.ask(question, self._deadline_s)
        proposal = _proposal(answer)
        command = Command(round(proposal.heater_duty * HEATER_LEVELS) / HEATER_LEVELS, proposal.fan_on)
        self._proposed = {"heater_duty": command.heater_duty, "fan_on": command.fan_on}
        why = {"tick": self._tick, "reference_c": question["reference_c"]}
        said = proposal.why
        return Decision(command, self.name, why=why if said is None else {**why, "client": _storable(said)})

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


def _proposal(answer: Mapping[str, Any]) -> Proposal:
    """Errors: RequestError for what is no duty or no state of a relay"""
    try:
        return read(Proposal, answer)
    except DocumentError as error:
        raise RequestError(str(error)) from None


def _storable(said: Any) -> Any:
    """Return a client's reason as the history can store it: 1e999 is infinite, "\\ud800" is not text."""
    try:
        size = len(json.dumps(said, allow_nan=False, ensure_ascii=False).encode())
    except (ValueError, RecursionError):
        return "not fit to be kept"
    return said if size <= WHY_MAX else "too long to keep"
