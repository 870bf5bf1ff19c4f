"""Numbers with a unit in plain text, and whether a value would be said so."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

from edge.core.names import HEATER_LEVELS

_NUMBER = r"(?<![\w.-])(?P<number>-?\d+(?:\.\d+)?)"
_DEGREES = re.compile(rf"{_NUMBER}\s*(?:°\s*C?\b|°|deg(?:rees?)?\b(?:\s*C(?:elsius)?\b)?|degC\b|C\b)")
_PERCENT = re.compile(rf"{_NUMBER}\s*(?:%|percent\b)")
_DUTY = re.compile(rf"\bduty(?:[ _]cycle)?(?:\s+(?:is|of|at|to|value|=))*\s*[=:]?\s*{_NUMBER}(?![\d.]*\s*%)")
_ENERGY = re.compile(rf"{_NUMBER}\s*(?P<unit>kWh|Wh)\b")
_ROUNDING = 0.05  # in units of the last digit: what binary numbers and double rounding may add


@dataclass(frozen=True, slots=True)
class Said:
    """A number as it was written, and the quantum of its last digit, both in the value's unit."""

    text: str
    value: float
    quantum: float


def degrees(text: str) -> list[Said]:
    """Temperatures [°C]."""
    return [_said(match, 1.0) for match in _DEGREES.finditer(text)]


def shares(text: str) -> list[Said]:
    """Heater duties 0..1, from "duty 0.45", and from percentages in a text that speaks of the heater.

    "0.5" is that level of the heater and not the next one.
    """
    found = [_said(match, 1.0, 1.0 / HEATER_LEVELS) for match in _DUTY.finditer(text)]
    if re.search(r"\b(?:duty|heater)\b", text, re.IGNORECASE):
        found += [_said(match, 0.01) for match in _PERCENT.finditer(text)]
    return found


def energies(text: str) -> list[Said]:
    """Energies [Wh]."""
    return [_said(match, 1000.0 if match["unit"] == "kWh" else 1.0) for match in _ENERGY.finditer(text)]


def fits(said: Said, values: Iterable[float]) -> bool:
    """Whether one of the values would be written so, rounded to the digits given."""
    most = said.quantum * (0.5 + _ROUNDING)
    return any(abs(said.value - value) <= most for value in values)


def _said(match: "re.Match[str]", factor: float, coarsest: float = math.inf) -> Said:
    number = match["number"]
    decimals = len(number.partition(".")[2])
    return Said(match[0].strip(), float(number) * factor, min(factor * 10.0**-decimals, coarsest))
