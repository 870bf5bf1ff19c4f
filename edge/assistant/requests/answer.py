"""An operator's request as the language model answers it: the question, the form of the answer, the check
that makes a Steering of the answer.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Any

from edge.assistant.llm.language_model import LanguageModel
from edge.assistant.llm.wire import Schema, read_object
from edge.config.settings import ReferenceSettings
from edge.core.errors import RequestError
from edge.core.plain_text import plain
from edge.formats.cross_check import CheckedDocument, Rule
from edge.formats.reader import DocumentError, read, read_number
from edge.tick.steering import HOURS_MAX, PENALTY_MAX, DailyTarget, FanRest, Steering

TARGETS_MAX = 24
RESTS_MAX = 12
TEXT_MAX = 600  # longer words of a model are cut
Clock = Annotated[str, Rule(pattern="([01][0-9]|2[0-3]):[0-5][0-9]")]  # local time
Penalty = Annotated[float, Rule(low=0.0, high=PENALTY_MAX)]

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
            "maxItems": TARGETS_MAX,  # else a grammar lets a small model go on for ever
            "items": _object({"from": _CLOCK_TEXT, "degc": {"type": "number"}}),
        },
        "heater_penalty": _NUMBER_OR_NULL,
        "fan_penalty": _NUMBER_OR_NULL,
        "heater_max_duty": _NUMBER_OR_NULL,
        "fan_rest": {
            "type": "array",
            "maxItems": RESTS_MAX,
            "items": _object({"from": _CLOCK_TEXT, "until": _CLOCK_TEXT}),
        },
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


@dataclass(frozen=True, slots=True)
class SaidTarget:
    """From a local time on, every day: a temperature."""

    start: Clock = field(metadata={"key": "from"})
    degc: float


@dataclass(frozen=True, slots=True)
class SaidRest:
    """The fan stays off between two local times."""

    start: Clock = field(metadata={"key": "from"})
    until: Clock


@dataclass(frozen=True, slots=True)
class WishAnswer(CheckedDocument):
    """The answer as a model gives it; SCHEMA asks for it."""

    reference: Annotated[tuple[SaidTarget, ...], Rule(most=TARGETS_MAX)]
    heater_penalty: Penalty | None
    fan_penalty: Penalty | None
    heater_max_duty: Annotated[float, Rule(low=0.0, high=1.0)] | None
    fan_rest: Annotated[tuple[SaidRest, ...], Rule(most=RESTS_MAX)]
    hours: Annotated[float, Rule(low=0.1, high=HOURS_MAX)]
    understood: str
    question: str

    def cross_check(self) -> None:
        """Check that the times are possible."""
        if any(not a.start < b.start for a, b in pairwise(self.reference)):
            self.refuse("reference", "the times must rise from one to the next, each once")
        if any(rest.start == rest.until for rest in self.fan_rest):
            self.refuse("fan_rest", "begins and ends at one time: heater_max_duty and the fan mode do that")


def understood(
    document: Mapping[str, Any], id: str, words: str, now_utc: float, limits: ReferenceSettings
) -> Understood:
    """Return the model's answer as a steering within the rig's limits.

    Errors : RequestError that names the key
    """
    try:
        said = read(WishAnswer, document)
        daily = tuple(
            DailyTarget(
                seconds_of_clock(target.start),
                read_number(target.degc, f"reference[{place}].degc", limits.min_c, limits.max_c),
            )
            for place, target in enumerate(said.reference)
        )
    except DocumentError as error:
        raise RequestError(str(error)) from None
    steering = Steering(
        id=id,
        words=words,
        until_utc=now_utc + 3600.0 * said.hours,
        daily=daily,
        heater_penalty=said.heater_penalty,
        fan_penalty=said.fan_penalty,
        heater_max_duty=said.heater_max_duty,
        fan_rest=tuple(
            FanRest(seconds_of_clock(rest.start), seconds_of_clock(rest.until)) for rest in said.fan_rest
        ),
    )
    text, question = plain(said.understood, TEXT_MAX), plain(said.question, TEXT_MAX)
    # A model that asks has not understood: what it guessed beside its question must not steer.
    if question or _asks_for_nothing(steering):
        return Understood(None, text, question or "What shall be different? Nothing was understood.")
    return Understood(steering, text, "")


def _asks_for_nothing(steering: Steering) -> bool:
    values = (steering.heater_penalty, steering.fan_penalty, steering.heater_max_duty)
    return not steering.daily and not steering.fan_rest and all(value is None for value in values)


def seconds_of_clock(clock: str) -> float:
    """Convert "HH:MM" to seconds since midnight."""
    hours, minutes = clock.split(":")
    return 3600.0 * int(hours) + 60.0 * int(minutes)


ANSWER_S = 120.0  # nobody waits for it but the operator


def settings_from(model: LanguageModel, messages: list[dict[str, str]]) -> Mapping[str, Any]:
    """Return the object in the model's answer. Errors: LlmFailure"""
    reply = model.endpoint.chat(messages, schema=Schema("settings", SCHEMA), deadline_s=ANSWER_S)
    return read_object(reply.content)
