"""A model's text held against what is known: its tool calls, what it was told, what the board confirmed.

A sentence is judged only where it surely claims something that can be looked up; plans, wishes and opinions
are not judged. The result flags and never changes a command.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from edge.assistant.llm.ledger import Ledger
from edge.core.controller import Context
from edge.core.messages import Command
from edge.core.names import HEATER_LEVELS
from edge.core.plain_text import plain

_NUMBER = r"(?<![\w.-])(?P<number>-?\d+(?:\.\d+)?)"
_DEGREES = re.compile(rf"{_NUMBER}\s*(?:°\s*C?\b|°|deg(?:rees?)?\b(?:\s*C(?:elsius)?\b)?|degC\b|C\b)")
_PERCENT = re.compile(rf"{_NUMBER}\s*(?:%|percent\b)")
_DUTY = re.compile(rf"\bduty(?:[ _]cycle)?(?:\s+(?:is|of|at|to|value|=))*\s*[=:]?\s*{_NUMBER}(?![\d.]*\s*%)")
_ENERGY = re.compile(rf"{_NUMBER}\s*(?P<unit>kWh|Wh)\b")
_ROUNDING = 0.05  # in units of the last digit: what binary numbers and double rounding may add


@dataclass(frozen=True, slots=True)
class WrittenNumber:
    """A number as it was written, and the quantum of its last digit, both in the value's unit."""

    text: str
    value: float
    quantum: float


def degrees(text: str) -> list[WrittenNumber]:
    """Temperatures [°C]."""
    return [_written_number(match, 1.0) for match in _DEGREES.finditer(text)]


def shares(text: str) -> list[WrittenNumber]:
    """Heater duties 0..1, from "duty 0.45", and from percentages in a text that speaks of the heater.

    "0.5" is that level of the heater and not the next one.
    """
    found = [_written_number(match, 1.0, 1.0 / HEATER_LEVELS) for match in _DUTY.finditer(text)]
    if re.search(r"\b(?:duty|heater)\b", text, re.IGNORECASE):
        found += [_written_number(match, 0.01) for match in _PERCENT.finditer(text)]
    return found


def energies(text: str) -> list[WrittenNumber]:
    """Energies [Wh]."""
    return [
        _written_number(match, 1000.0 if match["unit"] == "kWh" else 1.0) for match in _ENERGY.finditer(text)
    ]


def fits(said: WrittenNumber, values: Iterable[float]) -> bool:
    """Return whether one of the values reads like this when rounded to the digits given."""
    most = said.quantum * (0.5 + _ROUNDING)
    return any(abs(said.value - value) <= most for value in values)


def _written_number(match: "re.Match[str]", factor: float, coarsest: float = math.inf) -> WrittenNumber:
    number = match["number"]
    decimals = len(number.partition(".")[2])
    return WrittenNumber(match[0].strip(), float(number) * factor, min(factor * 10.0**-decimals, coarsest))


CLAIMS_MAX = 12  # of one text
_SENTENCE = re.compile(r"(?<=[.!?;])\s+(?=\S)|\n+")
_NOT_A_FACT = re.compile(
    r"\b(would|will|could|should|might|may|if|unless|whether|propose[ds]?|suggest(?:s|ed)?|recommend\w*|"
    r"want|expect\w*|to be|so that|in order to|when|once|until)\b",
    re.IGNORECASE,
)
_ACTED = re.compile(
    r"\b(?:I|we)(?:'ve| have| just)? (?:now |already |just )*(?:turned|switched|set|started|stopped|changed|"
    r"applied|activated|deactivated|raised|lowered|increased|reduced)\b(?P<rest>[^.;]*)",
    re.IGNORECASE,
)
_FAN_IS = re.compile(
    r"\bfan(?:'s| is| has been| was)(?: now| currently| already| still)? (?:turned |switched |running )?"
    r"(?P<state>on|off)\b(?! (?:average|demand|top))",
    re.IGNORECASE,
)
_HEATER_IS = re.compile(
    r"\bheater(?: duty|_duty)?(?: is| has been| was)(?: now| currently| already| still| running| set)* "
    r"(?:at |to |of )?(?P<value>on|off|\d[\d.]*\s*%?)",
    re.IGNORECASE,
)
_TOLD = (
    (re.compile(r"\b(?:target|reference|setpoint)\b", re.IGNORECASE), "reference"),
    (re.compile(r"\b(?:ambient|room|outside)\b", re.IGNORECASE), "ambient"),
    (re.compile(r"\b(?:current|present|now)\b", re.IGNORECASE), "air"),
)
_SIMULATED = re.compile(r"\b(?:simulat\w+|predict\w*|forecast\w*|rollout)\b", re.IGNORECASE)
_RECORDED = re.compile(
    r"\b(?:histor\w+|database|record(?:s|ed)|logs?|logged|past data|sql|query|rows?)\b", re.IGNORECASE
)
_CITED = re.compile(r"\bsimulate-\d+\b")


@dataclass(frozen=True, slots=True)
class Claim:
    """One claim of a text and whether it holds."""

    text: str
    kind: str  # action, state, told, simulation, history
    holds: bool
    against: str  # what it was held against, in words

    def to_json(self) -> dict[str, Any]:
        """As it stands in a decision's why."""
        return {"text": self.text, "kind": self.kind, "holds": self.holds, "against": self.against}


@dataclass(frozen=True, slots=True)
class KnownFacts:
    """The facts that a text is checked against."""

    context: Context
    ledger: Ledger
    chosen: Command


def check_claims(text: str, known: KnownFacts) -> list[Claim]:
    """Return the claims of `text` that can be judged, in its order."""
    found = [claim for sentence in _SENTENCE.split(text) for claim in _claims(sentence.strip(), known)]
    return found[:CLAIMS_MAX]


def _claims(sentence: str, known: KnownFacts) -> Iterator[Claim]:
    """Yield the claims of a sentence. A statement about tools is a claim even as a prediction."""
    yield from _actions(sentence, known.context.last_sent)
    if _SIMULATED.search(sentence):
        yield from _numbers(sentence, "simulation", known, _simulated_values)
    elif _RECORDED.search(sentence):
        yield from _numbers(sentence, "history", known, _records)
    elif not _NOT_A_FACT.search(sentence):
        yield from _states(sentence, known.context.last_sent)
        yield from _clause_claims(sentence, known.context)
        for energy in energies(sentence):
            yield _claim(sentence, "history", False, f"nothing that was read tells of {energy.text}")


def _actions(sentence: str, driven: Command) -> Iterator[Claim]:
    """Yield claims of actions. The model cannot act: a claimed action is
    true only if the board already did it.
    """
    for match in _ACTED.finditer(sentence):
        rest = match["rest"].lower()
        if "fan" not in rest and "heater" not in rest:
            continue
        wanted = re.search(r"\b(on|off)\b", match[0].lower())
        actual = driven.fan_on if "fan" in rest else driven.heater_duty > 0.0
        holds = wanted is not None and (wanted[1] == "on") == actual and not shares(rest)
        yield _claim(sentence, "action", holds, f"it can only propose; {_in_words(driven)}")


def _states(sentence: str, driven: Command) -> Iterator[Claim]:
    if _ACTED.search(sentence):
        return
    for match in _FAN_IS.finditer(sentence):
        yield _claim(sentence, "state", (match["state"].lower() == "on") == driven.fan_on, _in_words(driven))
    for match in _HEATER_IS.finditer(sentence):
        said = match["value"].lower()
        if said in ("on", "off"):
            holds = (said == "on") == (driven.heater_duty > 0.0)
        else:
            holds = any(fits(share, [driven.heater_duty]) for share in shares(f"duty {said}"))
        yield _claim(sentence, "state", holds, _in_words(driven))


def _clause_claims(sentence: str, context: Context) -> Iterator[Claim]:
    """Yield claims of a clause with one name and one temperature: the
    target is, the ambient temperature is.
    """
    values = {
        "reference": float(context.reference[0]),
        "ambient": context.estimate.temp_ambient,
        "air": context.estimate.temp_air,
    }
    for clause in re.split(r",|\band\b|\bbut\b|\bwhile\b", sentence):
        names = [name for pattern, name in _TOLD if pattern.search(clause)]
        said = degrees(clause)
        if len(names) == 1 and len(said) == 1 and re.search(r"\b(?:is|of|at)\b", clause):
            value = values[names[0]]
            yield _claim(clause, "told", fits(said[0], [value]), f"{names[0]} {value:.2f} degC")


def _numbers(
    sentence: str, kind: str, known: KnownFacts, values: Callable[[str, KnownFacts], tuple[list[float], str]]
) -> Iterator[Claim]:
    """Every temperature, duty and energy of a sentence must stand in what the tool has said."""
    there, against = values(sentence, known)
    for said in (*degrees(sentence), *shares(sentence), *energies(sentence)):
        yield _claim(sentence, kind, fits(said, there), f"{said.text}: {against}")


def _simulated_values(sentence: str, known: KnownFacts) -> tuple[list[float], str]:
    """Return the values of the simulation that is named, else of all. The target
    and the present value may stand with them.
    """
    entries = [entry for entry in known.ledger.entries if entry.tool == "simulate"]
    cited = set(_CITED.findall(sentence))
    entries = [entry for entry in entries if not cited or entry.id in cited]
    values = [number for entry in entries for number in _flat(entry.result)]
    against = "no simulation was asked for" if not entries else ", ".join(entry.id for entry in entries)
    return values + (_of_context(known) if entries else []), against


def _records(sentence: str, known: KnownFacts) -> tuple[list[float], str]:
    results = known.ledger.results("sql")
    values = [number for result in results for number in _flat(result["rows"])]
    against = "the history was not asked" if not results else f"{len(results)} answers of the history"
    return values + (_of_context(known) if results else []), against


def _of_context(known: KnownFacts) -> list[float]:
    context = known.context
    told = [float(context.reference[0]), context.estimate.temp_ambient, context.estimate.temp_air]
    return [*told, context.last_sent.heater_duty, known.chosen.heater_duty]


def _flat(value: Any) -> Iterator[float]:
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for item in value:
            yield from _flat(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)


def _in_words(driven: Command) -> str:
    return f"the board confirmed heater {driven.heater_duty:.2f}, fan {'on' if driven.fan_on else 'off'}"


def _claim(text: str, kind: str, holds: bool, against: str) -> Claim:
    return Claim(plain(text.strip(), 160), kind, holds, against)
