"""diagnosis.json: its schema, made from its types, and the check against this schema before it is written.

`python -m edge.diagnosis.diagnosis_file` prints the schema. The rig has no schema library.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NotRequired, get_args, get_origin, get_type_hints, is_typeddict

from edge.core.errors import DataError
from edge.diagnosis.diagnosis_document import DiagnosisDocument, Meaning
from edge.formats.atomic_file import write_atomically

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
        "required": [key for key in hints if key in kind.__required_keys__],
        "properties": {key: _schema_of(hint) for key, hint in hints.items()},
    }


def _describe(found: Schema, meaning: Meaning) -> Schema:
    if found["type"] == "string" or found["type"] == ["string", "null"]:
        found = {**found, "minLength": 1}
    found = {**found, "description": meaning.text}
    return found if meaning.minimum is None else {**found, "minimum": meaning.minimum}


FILE_NAME = "diagnosis.json"
_KINDS: Mapping[str, type | tuple[type, ...]] = {
    "object": dict,
    "array": (list, tuple),
    "string": str,
    "boolean": bool,
    "number": (int, float),
    "null": type(None),
}


def check_diagnosis(document: Mapping[str, Any]) -> None:
    """Refuse what is not a diagnosis: a key that is missing or of another kind, NaN, infinity, or an answer
    that contradicts itself.

    Errors : DataError, `diagnosis: gap.after.train.rmse_k: nan is not a finite number`
    """
    _check(dict(document), schema(), "")
    if document["verdict"] == "named" and not document["effects"]:
        raise _wrong("effects", "the verdict is `named`, but no effect is")
    if document["verdict"] == "nothing_missing" and document["effects"]:
        raise _wrong("effects", "the verdict is `nothing_missing`, but an effect is named")
    for run, series in document["predictions"].items():
        if len(series["before"]) != len(series["after"]):
            raise _wrong(f"predictions.{run}", "before and after are not of one length")


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a diagnosis, a line a key. Errors: DataError as of `check_diagnosis`; OSError"""
    check_diagnosis(document)
    lines = [f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in document.items()]
    write_atomically(path, "{\n" + ",\n".join(lines) + "\n}\n")


def _check(value: Any, rule: Schema, place: str) -> None:
    """Check a value by the keywords of JSON Schema that this schema uses, and no others."""
    if "enum" in rule:
        if value not in rule["enum"]:
            raise _wrong(place, f"{value!r} is none of {', '.join(rule['enum'])}")
        return
    kinds = rule["type"] if isinstance(rule["type"], list) else [rule["type"]]
    if not any(_is(value, kind) for kind in kinds):
        raise _wrong(place, f"{type(value).__name__} where {' or '.join(kinds)} belongs")
    if isinstance(value, dict):
        _check_keys(value, rule, place)
    elif isinstance(value, (list, tuple)):
        for number, item in enumerate(value):
            _check(item, rule["items"], f"{place}[{number}]")
    elif isinstance(value, str):
        if len(value) < rule.get("minLength", 0):
            raise _wrong(place, "is empty")
    elif value is not None:
        _check_number(value, rule, place)


def _check_keys(value: dict[str, Any], rule: Schema, place: str) -> None:
    known, other = rule.get("properties", {}), rule.get("additionalProperties")
    for key in rule.get("required", ()):
        if key not in value:
            raise _wrong(_below(place, key), "missing")
    for key, item in value.items():
        if inner := known.get(key, other):
            _check(item, inner, _below(place, key))


def _check_number(value: float, rule: Schema, place: str) -> None:
    if not math.isfinite(value):
        raise _wrong(place, f"{value} is not a finite number")
    if value < rule.get("minimum", -math.inf):
        raise _wrong(place, f"{value} is below {rule['minimum']}")


def _is(value: Any, kind: str) -> bool:
    """Return whether `value` is of a kind of JSON. True and False are not numbers there."""
    return isinstance(value, _KINDS[kind]) and (kind == "boolean" or not isinstance(value, bool))


def _below(place: str, key: str) -> str:
    return f"{place}.{key}" if place else key


def _wrong(place: str, problem: str) -> DataError:
    return DataError(f"diagnosis: {place + ': ' if place else ''}{problem}")


if __name__ == "__main__":
    print(json.dumps(schema(), indent=2, ensure_ascii=False))
