"""JSON from outside: one object, no NaN, no infinity, never an exception but ValueError."""

import json
from typing import Any, NoReturn


def parse_object(text: bytes | str) -> dict[str, Any]:
    """The object that `text` is. Errors: ValueError, fit to be shown to the one who sent it."""
    try:
        value = json.loads(text, parse_constant=_refuse)
    except RecursionError:  # a kilobyte of "[" is enough
        raise ValueError("nested too deep") from None
    except UnicodeDecodeError:
        raise ValueError("not UTF-8") from None
    if not isinstance(value, dict):
        raise ValueError("not a JSON object")
    return value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")
