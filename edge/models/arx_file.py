"""The ARX model as a JSON file: coefficients, units, validity box and where they come from."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import DataError
from edge.core.plain_text import shown
from edge.formats.input_file import Source, read_file
from edge.formats.strict_json import parse_object
from edge.models.arx import Arx, FanInput

DEFAULT_PATH = Path(__file__).with_name("default_arx.json")
_FORMAT = 2
_KEYS = {"format", "model", "step_s", "temp_air", "heater_duty", "fan_on", "fan_input", "temp_ambient",
         "intercept", "units", "validity", "provenance"}  # fmt: skip
_UNITS = {
    "step_s": "s",
    "temp_air": "K/K",
    "heater_duty": "K",
    "temp_ambient": "K/K",
    "intercept": "K",
    "validity": "as the column's key says",
}


def write_arx(model: Arx, path: Path, provenance: Mapping[str, Any]) -> None:
    """Write `model` to `path`; `provenance` holds JSON values (data sha256, command, scores, software)."""
    document = {
        "format": _FORMAT,
        "model": "arx",
        "step_s": model.step_s,
        "temp_air": model.temp.tolist(),
        "heater_duty": model.heater.tolist(),
        "fan_on": model.fan.tolist(),
        "fan_input": model.fan_input,
        "temp_ambient": model.ambient,
        "intercept": model.intercept,
        "units": _UNITS | {"fan_on": "K" if model.fan_input == "on" else "K/K"},
        "validity": {key: list(pair) for key, pair in model.validity.items()},
        "provenance": dict(provenance),
    }
    path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def read_arx(path: Source = DEFAULT_PATH) -> Arx:
    """The model in `path`; its version is the first 12 hex digits of the file's sha256.

    Raises : DataError naming the file and the key
    """
    try:
        content = read_file(path)
        document = parse_object(content)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise DataError(f"{path}: not JSON: {error}") from error
    if document.get("model") != "arx":
        raise DataError(f"{path}: model: not an ARX model")
    if document.get("format") != _FORMAT:
        raise DataError(f"{path}: format: {shown(document.get('format'))} is not {_FORMAT}")
    if missing := sorted(_KEYS - document.keys()):
        raise DataError(f"{path}: {missing[0]}: missing")
    heater, fan = _numbers(path, document, "heater_duty"), _numbers(path, document, "fan_on")
    if len(heater) != len(fan):
        raise DataError(f"{path}: fan_on: {len(fan)} coefficients, heater_duty has {len(heater)}")
    step_s = _number(path, document, "step_s")
    if not step_s > 0.0:
        raise DataError(f"{path}: step_s: {step_s} is not above 0")
    return Arx(
        temp=_numbers(path, document, "temp_air"),
        heater=heater,
        fan=fan,
        ambient=_number(path, document, "temp_ambient"),
        intercept=_number(path, document, "intercept"),
        step_s=step_s,
        version=hashlib.sha256(content).hexdigest()[:12],
        validity=_validity(path, document["validity"]),
        fan_input=_fan_input(path, document["fan_input"]),
    )


def _fan_input(path: Source, value: Any) -> FanInput:
    if value in get_args(FanInput):
        return cast(FanInput, value)
    raise DataError(f'{path}: fan_input: {shown(value)} is neither "on" nor "excess"')


def _number(path: Source, document: Mapping[str, Any], key: str) -> float:
    value = document[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise DataError(f"{path}: {key}: {shown(value)} is not a number")
    return float(value)


def _numbers(path: Source, document: Mapping[str, Any], key: str) -> NDArray[np.float64]:
    values = document[key]
    if not isinstance(values, list) or not values:
        raise DataError(f"{path}: {key}: not a list of numbers")
    return np.array([_number(path, {key: value}, key) for value in values])


def _validity(path: Source, value: Any) -> dict[str, tuple[float, float]]:
    try:
        return {str(key): (float(low), float(high)) for key, (low, high) in value.items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise DataError(f"{path}: validity: not pairs of numbers by column") from error
