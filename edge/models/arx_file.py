"""The ARX model as a JSON file: coefficients, units, validity box and where they come from."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from edge.formats.atomic_file import write_atomically
from edge.formats.cross_check import CheckedDocument, Rule
from edge.formats.input_file import Source
from edge.formats.reader import parse_json, read, read_bytes
from edge.models.arx import Arx, FanInput

DEFAULT_PATH = Path(__file__).with_name("default_arx.json")
_FORMAT = 2
Coefficients = Annotated[tuple[float, ...], Rule(least=1)]
_UNITS = {
    "step_s": "s",
    "temp_air": "K/K",
    "heater_duty": "K",
    "temp_ambient": "K/K",
    "intercept": "K",
    "validity": "as the column's key says",
}


@dataclass(frozen=True, slots=True)
class ArxDocument(CheckedDocument):
    """The file, key by key."""

    format: Literal[2]
    model: Literal["arx"]
    step_s: Annotated[float, Rule(above=0.0)]
    temp_air: Coefficients
    heater_duty: Coefficients
    fan_on: Coefficients
    fan_input: FanInput
    temp_ambient: float
    intercept: float
    units: Mapping[str, str]
    validity: Mapping[str, tuple[float, float]]
    provenance: Mapping[str, Any]

    def cross_check(self) -> None:
        """Refuse a heater and a fan that do not reach back equally far."""
        if len(self.heater_duty) != len(self.fan_on):
            self.refuse("fan_on", f"{len(self.fan_on)} coefficients, heater_duty has {len(self.heater_duty)}")


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
    write_atomically(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def read_arx(path: Source = DEFAULT_PATH) -> Arx:
    """Read the model in `path`; its version is the first 12 hex digits of the file's sha256.

    Raises : DataError naming the file and the key
    """
    content = read_bytes(path)
    found = read(ArxDocument, parse_json(content, str(path)), str(path))
    return Arx(
        temp=np.array(found.temp_air),
        heater=np.array(found.heater_duty),
        fan=np.array(found.fan_on),
        ambient=found.temp_ambient,
        intercept=found.intercept,
        step_s=found.step_s,
        version=hashlib.sha256(content).hexdigest()[:12],
        validity=found.validity,
        fan_input=found.fan_input,
    )
