"""Differences between two JSON values, number by number."""

import math
from collections.abc import Iterator
from typing import Any


def first_difference(kept: Any, now: Any, tolerance: float = 0.0, place: str = "evaluation.json") -> str:
    """Return where two JSON values differ first; "" where no two numbers do by more than `tolerance`."""
    found = (text for amount, text in differences(kept, now, place) if not amount <= tolerance)
    return next(found, "")


def differences(kept: Any, now: Any, place: str) -> Iterator[tuple[float, str]]:
    """Yield how much two JSON values differ and where; infinitely, where one of both is not a number."""
    if isinstance(kept, dict) and isinstance(now, dict) and kept.keys() == now.keys():
        for key in kept:
            yield from differences(kept[key], now[key], f"{place}.{key}")
    elif isinstance(kept, list) and isinstance(now, list) and len(kept) == len(now):
        for index, (a, b) in enumerate(zip(kept, now, strict=True)):
            yield from differences(a, b, f"{place}.{index}")
    elif kept != now:
        amount = abs(kept - now) if _is_number(kept) and _is_number(now) else math.inf
        yield amount, f"{place}: {kept!r} is kept, now {now!r}"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
