"""The JSON schema of diagnosis.json, made from its types: run this module to print it."""

import json
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NotRequired, get_args, get_origin, get_type_hints, is_typeddict

from edge.diagnosis.diagnosis_document import DiagnosisDocument, Meaning

Schema = dict[str, Any]

TITLE = (
    "Diagnosis of a twin: where it disagrees with the measurements, what is missing, what adding it brings"
)
_PLAIN = {str: "string", float: "number", bool: "boolean"}


def schema() -> Schema:
    """Return the JSON Schema, draft 2020-12, as plain values."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": TITLE,
        **_schema_of(DiagnosisDocument),
    }


def document() -> str:
    """Return the schema as the file in this folder has it."""
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"


def _schema_of(kind: Any) -> Schema:
    """Return the schema of a type. Errors: TypeError for one that diagnosis.json does not use"""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is NotRequired:
        return _schema_of(parts[0])
    if origin is Annotated:
        return _describe(_schema_of(parts[0]), parts[1])
    if origin is UnionType:
        (inner,) = (part for part in parts if part is not NoneType)
        found = _schema_of(inner)
        return {**found, "type": [found["type"], "null"]}
    if origin is Literal:
        return {"enum": list(parts)}
    if origin is list:
        return {"type": "array", "items": _schema_of(parts[0])}
    if origin is dict:
        return {"type": "object", "additionalProperties": _schema_of(parts[1])}
    if is_typeddict(kind):
        return _object(kind)
    if kind in _PLAIN:
        return {"type": _PLAIN[kind]}
    raise TypeError(f"{kind} has no JSON schema")


def _object(kind: Any) -> Schema:
    hints = get_type_hints(kind, include_extras=True)
    return {
        "type": "object",
        "additionalProperties": False,
        "required": [key for key in hints if key in kind.__required_keys__],
        "properties": {key: _schema_of(hint) for key, hint in hints.items()},
    }


def _describe(found: Schema, meaning: Meaning) -> Schema:
    if meaning.is_open:
        found = {
            key: value for key, value in found.items() if key not in ("additionalProperties", "required")
        }
    if found["type"] == "string" or found["type"] == ["string", "null"]:
        found = found if meaning.may_be_empty else {**found, "minLength": 1}
    found = {**found, "description": meaning.text}
    return found if meaning.minimum is None else {**found, "minimum": meaning.minimum}


if __name__ == "__main__":
    print(document(), end="")
