"""The JSON schema of a twin file, written from the table of effects: run this module to print it."""

import json
from dataclasses import fields
from typing import Any

from edge.twin.effects.effect import Effect
from edge.twin.effects.library import EFFECTS
from edge.twin.geometry import Geometry, Scale
from edge.twin.model import FAN_CONTROLS
from edge.twin.twin_file import FAN_ROLES, NUISANCE, SENSOR

_NUMBER = {"type": "number"}
# Of heat and time, beside the paper's box: a file's own heater and step say more.
_LEAST, _MOST = Scale(1e-3, 1e-3), Scale(1e3, 1e3)


def schema() -> dict[str, Any]:
    """JSON Schema, draft 2020-12, as plain values."""
    ageing = [name for name, effect in EFFECTS.items() if effect.counts_days]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Twin file: geometry, known effects, and how well each value is known",
        "type": "object",
        "additionalProperties": False,
        "properties": {
            "geometry": _object({item.name: _value(0.0, None, "") for item in fields(Geometry)}),
            "sample_s": {"type": "number", "exclusiveMinimum": 0, "description": "length of a step [s]"},
            "fan_role": {"enum": list(FAN_ROLES), "description": "what the fan does; default: exhaust"},
            "fan_control": {
                "enum": list(FAN_CONTROLS),
                "description": "what a fan between 0 and 1 is: with a relay the share of the step, from its "
                "beginning, for which it is on; else its speed; default: relay",
            },
            "day0_utc": {
                "type": ["string", "null"],
                "description": f"where the days of {' and '.join(ageing)} begin, ISO 8601",
            },
            "effects": _object({name: _effect(effect) for name, effect in EFFECTS.items()}),
            "sensor": _object({key: _spread() for key in SENSOR}),
            "nuisance": _object({key: _spread() for key in NUISANCE}),
            "provenance": {"type": "object", "description": "where the values come from"},
        },
    }


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": False, "properties": properties}


def _spread() -> dict[str, Any]:
    return {"type": ["number", "null"], "minimum": 0, "description": "null: not known"}


def _effect(effect: Effect) -> dict[str, Any]:
    values = {
        item.name: _value(_LEAST.usual(item).low, _MOST.usual(item).high, item.unit)
        for item in effect.parameters
    }
    return {
        **_object(values),
        "required": list(values),
        "description": " ".join((effect.add.__doc__ or "").split()),
    }


def _value(low: float, high: float | None, unit: str) -> dict[str, Any]:
    """Exact, uncertain or fitted, or to be fitted."""
    bounded = {**_NUMBER, "minimum": low} | ({} if high is None else {"maximum": high})
    known = {"value": bounded, "rel_sd": {**_NUMBER, "exclusiveMinimum": 0}, "low": _NUMBER, "high": _NUMBER}
    to_fit = {"fit": {"const": True}, "start": bounded}
    return {
        "description": f"[{unit or '1'}]",
        "anyOf": [
            bounded,
            {
                **_object(known),
                "required": ["value"],
                "dependentRequired": {"low": ["high"], "high": ["low"]},
            },
            {**_object(to_fit), "required": ["fit"]},
        ],
    }


def document() -> str:
    """Return the schema as the file in this folder has it."""
    return json.dumps(schema(), indent=2) + "\n"


if __name__ == "__main__":
    print(document(), end="")
