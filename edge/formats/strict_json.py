"""JSON from outside: one object, no key twice, finite numbers, storable text, bounded depth.

Only ValueError is raised.
"""

import json
import math
from typing import Any, NoReturn

from edge.core.plain_text import plain, quote, storable

DEPTH_MAX = 64  # far below the recursion limit, so that every value can be written and printed again
DIGITS_MAX = 300  # of a whole number; one of more does not fit into a float


def parse_object(text: bytes | str) -> dict[str, Any]:
    """Parse an object. Errors: ValueError, whose text may be shown to the sender"""
    try:
        value = _clean(
            json.loads(
                text, object_pairs_hook=_object, parse_constant=_refuse, parse_float=_float, parse_int=_int
            ),
            1,
        )
    except RecursionError:  # a kilobyte of "[" is enough
        raise ValueError("nested too deep") from None
    except UnicodeDecodeError:
        raise ValueError("not UTF-8") from None
    except ValueError as error:
        raise ValueError(plain(str(error))) from None
    if not isinstance(value, dict):
        raise ValueError("not a JSON object")
    return value


def _clean(value: Any, depth: int) -> Any:
    """Return the value with storable texts: "\\ud800" is JSON, but no storable text."""
    if isinstance(value, str):
        return storable(value)
    if isinstance(value, list | dict) and depth > DEPTH_MAX:
        raise ValueError("nested too deep")
    if isinstance(value, list):
        return [_clean(item, depth + 1) for item in value]
    if isinstance(value, dict):
        return _object([(storable(key), _clean(item, depth + 1)) for key, item in value.items()])
    return value


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """As Python does it, which would let the last of two equal keys win."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"key {quote(twice)} is given twice")
    return found


def _float(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits} is too large")
    return value


def _int(digits: str) -> int:
    if len(digits) > DIGITS_MAX:
        raise ValueError(f"a whole number of {len(digits)} digits")
    return int(digits)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")
