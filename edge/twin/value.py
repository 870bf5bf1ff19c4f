"""A number of a twin file and how it is known: exact, uncertain, to be fitted, or fitted."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from edge.core.errors import DataError
from edge.core.plain_text import shown
from edge.formats.checked import nearest

KEYS = ("value", "rel_sd", "low", "high", "fit", "start")


@dataclass(frozen=True, slots=True)
class Value:
    """`5.1`, `{value, rel_sd}`, `{fit: true, start}` or `{value, low, high}` of a file."""

    value: float  # where a fit starts, as long as it is to be fitted
    rel_sd: float | None = None  # of a prior, share of the value
    low: float | None = None  # 95 % interval
    high: float | None = None
    fit: bool = False

    def document(self) -> Any:
        """As the file has it."""
        if self.fit:
            return {"fit": True, "start": self.value}
        known = {"value": self.value, "rel_sd": self.rel_sd, "low": self.low, "high": self.high}
        given = {key: item for key, item in known.items() if item is not None}
        return given if len(given) > 1 else self.value


def read_value(place: str, document: Any, start: float | None = None) -> Value:
    """The value that a file gives at `place`.

    start : where a fit begins if the file does not say; None where it must
    Errors : DataError, beginning with `place`
    """
    if not isinstance(document, Mapping):
        return Value(number(place, document))
    for key in document:
        if key not in KEYS:
            raise DataError(f"{place}: unknown key {shown(key)}; {nearest(str(key), KEYS)}")
    if "fit" in document:
        return _to_fit(place, document, start)
    numbers = {key: number(f"{place}.{key}", item) for key, item in document.items()}
    if "value" not in numbers:
        raise DataError(f"{place}.value: missing")
    if "start" in numbers:
        raise DataError(f"{place}.start: goes with fit: true alone")
    if ("low" in numbers) != ("high" in numbers):
        raise DataError(f"{place}: low and high go together")
    if "low" in numbers and not numbers["low"] <= numbers["value"] <= numbers["high"]:
        raise DataError(f"{place}: {numbers['value']:g} is outside {numbers['low']:g}..{numbers['high']:g}")
    if "rel_sd" in numbers and not numbers["rel_sd"] > 0.0:
        raise DataError(f"{place}.rel_sd: {numbers['rel_sd']:g} is not above 0")
    return Value(numbers["value"], numbers.get("rel_sd"), numbers.get("low"), numbers.get("high"))


def _to_fit(place: str, document: Mapping[str, Any], start: float | None) -> Value:
    if document["fit"] is not True:
        raise DataError(f"{place}.fit: {shown(document['fit'])} is not true; a known value has no such key")
    for key in document:
        if key not in ("fit", "start"):
            raise DataError(f"{place}.{key}: does not go with fit: true")
    if "start" in document:
        return Value(number(f"{place}.start", document["start"]), fit=True)
    if start is None:
        raise DataError(f"{place}.start: missing")
    return Value(start, fit=True)


def number(place: str, document: Any) -> float:
    """A finite number. Errors: DataError, beginning with `place`."""
    if isinstance(document, bool) or not isinstance(document, int | float) or not math.isfinite(document):
        raise DataError(f"{place}: {shown(document)} is not a number")
    return float(document)
