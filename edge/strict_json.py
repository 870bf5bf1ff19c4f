"""JSON from outside: one object, no NaN, no infinity, storable text, never an exception but ValueError."""

import json
from typing import Any, NoReturn

from edge.plain_text import plain, storable


def parse_object(text: bytes | str) -> dict[str, Any]:
    """The object that `text` is. Errors: ValueError, fit to be shown to the one who sent it."""
    try:
        value = _cleaned(json.loads(text, parse_constant=_refuse))
    except RecursionError:  # a kilobyte of "[" is enough
        raise ValueError("nested too deep") from None
    except UnicodeDecodeError:
        raise ValueError("not UTF-8") from None
    except ValueError as error:
        raise ValueError(plain(str(error))) from None
    if not isinstance(value, dict):
        raise ValueError("not a JSON object")
    return value


def _cleaned(value: Any) -> Any:
    """The value with storable texts: "\\ud800" is JSON, and no text that can be stored."""
    if isinstance(value, str):
        return storable(value)
    if isinstance(value, list):
        return [_cleaned(item) for item in value]
    if isinstance(value, dict):
        return {storable(key): _cleaned(item) for key, item in value.items()}
    return value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")
