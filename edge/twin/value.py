"""A number of a twin file and how it is known: exact, uncertain, to be fitted, or fitted."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from edge.core.errors import DataError
from edge.formats.cross_check import ABSENT, CheckedDocument, Rule
from edge.formats.reader import read, read_number

SDS_95 = 1.959964  # standard deviations of a normal distribution on either side that hold 95 %


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


@dataclass(frozen=True, slots=True)
class KnownValue(CheckedDocument):
    """`{value, rel_sd}` or `{value, low, high}` of a file."""

    value: float
    rel_sd: Annotated[float, Rule(above=0.0)] = ABSENT
    low: float = ABSENT
    high: float = ABSENT

    def cross_check(self) -> None:
        """Check that the interval holds the value."""
        if (self.low is None) != (self.high is None):
            self.refuse("", "low and high go together")
        if self.low is not None and not self.low <= self.value <= self.high:
            self.refuse("", f"{self.value:g} is outside {self.low:g}..{self.high:g}")


@dataclass(frozen=True, slots=True)
class ValueToFit:
    """`{fit: true, start}` of a file."""

    fit: Literal[True]
    start: float = ABSENT


def read_value(place: str, document: Any, start: float | None = None) -> Value:
    """Read the value that a file gives at `place`.

    start : where a fit begins if the file does not say; None where it must
    Errors : DataError, beginning with `place`
    """
    if not isinstance(document, Mapping):
        return Value(read_number(document, place))
    if "fit" not in document:
        known = read(KnownValue, document, key=place)
        return Value(known.value, known.rel_sd, known.low, known.high)
    to_fit = read(ValueToFit, document, key=place)
    begin = start if to_fit.start is None else to_fit.start
    if begin is None:
        raise DataError(f"{place}.start: missing")
    return Value(begin, fit=True)
