"""One field on the wire: a raw integer there, a value here. Used by the generated `messages.py`."""

import operator
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from firmware_protocol.errors import LocalProtocolError

_TABLE_MAX = 15  # entries; the enumerations of the protocol have at most 8


@dataclass(frozen=True, slots=True)
class Field:
    """How one value travels.

    low, high : smallest and largest raw integer
    per_unit : raw counts per unit, None for a value that is an integer here as well
    none : the raw integer that says "there is no number"
    kind : makes the value of an unscaled raw integer (int, bool or an enum)
    """

    name: str
    code: str  # letter of the struct module
    low: int
    high: int
    per_unit: int | None = None
    none: int | None = None
    kind: Callable[[int], Any] = int

    def to_raw(self, value: Any) -> int:
        """Raw integer of a value; NaN and None travel as `none`. Raises LocalProtocolError out of range."""
        if self.none is not None and (value is None or value != value):
            return self.none
        try:
            raw = operator.index(value) if self.per_unit is None else round(value * self.per_unit)
        except (TypeError, ValueError, OverflowError):  # None, NaN, inf where the wire has no word for them
            raise LocalProtocolError(f"{self.name}: {value!r} can't be sent") from None
        if not self.low <= raw <= self.high:
            raise LocalProtocolError(f"{self.name}: {value!r} is out of range")
        return raw

    def from_raw(self, raw: int) -> Any:
        """Value of a raw integer that is in range."""
        if raw == self.none:
            return None
        return self.kind(raw) if self.per_unit is None else raw / self.per_unit

    def reader(self) -> Callable[[int], Any]:
        """Return `from_raw`, as a table where that is short: ten times faster than an enum's class."""
        if self.kind is int or self.high - self.low > _TABLE_MAX:
            return self.from_raw
        return {raw: self.from_raw(raw) for raw in range(self.low, self.high + 1)}.__getitem__


class Layout:
    """The fields of one message, in the order in which they travel."""

    def __init__(self, kind: int, from_board: bool, fields: tuple[Field, ...]) -> None:
        self.kind = kind
        self.from_board = from_board
        self.fields = fields
        self.struct = struct.Struct("<" + "".join(field.code for field in fields))
        self._bounds = tuple((field.low, field.high, field.none) for field in fields)
        self._reads = tuple(field.reader() for field in fields)

    def pack(self, message: object) -> bytes:
        """Body of a message."""
        return self.struct.pack(*(field.to_raw(getattr(message, field.name)) for field in self.fields))

    def first_refused(self, raws: tuple[int, ...]) -> int | None:
        """Return the number of the first field (from 0) whose raw integer is
        out of range, None when all are good.
        """
        for i, (raw, (low, high, none)) in enumerate(zip(raws, self._bounds, strict=True)):
            if not low <= raw <= high and raw != none:
                return i
        return None

    def values(self, raws: tuple[int, ...]) -> list[Any]:
        """Return the values of raw integers that are all good."""
        return [read(raw) for read, raw in zip(self._reads, raws, strict=True)]
