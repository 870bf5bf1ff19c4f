"""The page's calls as an OpenAPI document, made from routes and orders: run this module to print it.

The file static/openapi.json is served; the page itself never imports this module, which brings numpy.
"""

import json
from dataclasses import MISSING, fields
from enum import Enum
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from edge.app.nightly_diagnosis import AdoptRequest
from edge.assistant.requests.desk import DiscardRequest, UndoRequest
from edge.assistant.requests.memory import ForgetRequest, RememberRequest
from edge.bundle.keeper import BundleRequest
from edge.core.version import __version__
from edge.formats.cross_check import CheckedDocument, Rule
from edge.page.access import LINK_DAYS_MAX, NEEDS, ROLES
from edge.page.app import API
from edge.page.questions import NEEDED, OPTIONS, WALL, WALL_MAX
from edge.tick.orders import ORDERS

Json = dict[str, Any]

NUMBER, TEXT, WHOLE = {"type": "number"}, {"type": "string"}, {"type": "integer"}
UTC = {"type": "number", "description": "seconds since 1970, UTC"}
SEVERITIES = {"enum": ["info", "warning", "alarm"]}
# Parameters behind the question mark, by path: name -> schema, whether it may be left out.
PARAMETERS: dict[str, dict[str, tuple[Json, bool]]] = {
    "/api/course": {"from_utc": (UTC, False), "to_utc": (UTC, False), "points": (WHOLE, True)},
    "/api/export": {"from_utc": (UTC, False), "to_utc": (UTC, False)},
    "/api/why": {"at_utc": (UTC, False)},
    "/api/what-if": {
        **{name: (NUMBER, name not in NEEDED) for name in OPTIONS},
        WALL: ({"type": "string", "maxLength": WALL_MAX}, True),
    },
    "/api/events": {"before_utc": (UTC, True), "least": (SEVERITIES, True), "most": (WHOLE, True)},
}
# Bodies of POST, by path: name -> schema.
BODIES: dict[str, Json] = {
    "/api/session": {"link": TEXT, "name": TEXT, "password": TEXT},
    "/api/events/acknowledge": {"seq": WHOLE, "number": WHOLE},
    "/api/links": {
        "role": {"enum": list(ROLES)},
        "days": {"type": "number", "exclusiveMinimum": 0, "maximum": LINK_DAYS_MAX},
        "name": TEXT,
    },
    "/api/alarms/test": {"channel": TEXT},
    "/api/alarms/acknowledge": {"id": WHOLE},
}
OF_THE_DESK: dict[str, Json] = {  # orders that the loop does not know
    "clear_trip": {},
    "ask": {"words": TEXT},
    "proposal": {"id": TEXT},
    "confirm": {"id": TEXT},
    "memory": {},
}
# Orders by their documents that the loop does not know, or that the desk takes in its place.
DOCUMENTS = {
    "discard": DiscardRequest,
    "undo": UndoRequest,
    "remember": RememberRequest,
    "forget": ForgetRequest,
    "bundle": BundleRequest,
    "adopt": AdoptRequest,
}
NOT_JSON = {
    "/api/stream": "text/event-stream",
    "/api/export": "text/csv",
    "/api/diagnoses/{name}/report": "text/html",
}


def openapi() -> Json:
    """OpenAPI 3.1, as plain values."""
    paths: Json = {}
    for method, path, role, handler in API:
        needs = "Anybody may call it." if role is None else f"Needs the role {role.word}."
        operation: Json = {
            "summary": (handler.__doc__ or "").partition("\n")[0],
            "description": needs,
            "responses": _responses(path),
        }
        if role is None:
            operation["security"] = []
        if found := _parameters(path):
            operation["parameters"] = found
        if method == "POST":
            operation["requestBody"] = {"content": {"application/json": {"schema": _body(path)}}}
        paths.setdefault(path.replace(":int}", "}"), {})[method.lower()] = operation
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "The page of a greenhouse",
            "version": __version__,
            "description": "A change is JSON. From a browser it has to come from the page's own address.",
        },
        "paths": paths,
        "components": {"securitySchemes": {"session": {"type": "http", "scheme": "bearer"}}},
        "security": [{"session": []}],
    }


def _responses(path: str) -> Json:
    kind = NOT_JSON.get(path, "application/json")
    refused = {"schema": _object({"ok": {"const": False}, "error": TEXT})}
    return {
        "200": {"description": "done", "content": {kind: {"schema": {}}}},
        "default": {"description": "refused, with the reason", "content": {"application/json": refused}},
    }


def _parameters(path: str) -> list[Json]:
    given = [
        {"name": name, "in": "query", "required": not optional, "schema": schema}
        for name, (schema, optional) in PARAMETERS.get(path, {}).items()
    ]
    in_path = [name.partition(":") for name in path.replace("}", "{").split("{")[1::2]]
    return given + [
        {"name": name, "in": "path", "required": True, "schema": WHOLE if kind else TEXT}
        for name, _, kind in in_path
    ]


def _body(path: str) -> Json:
    if path == "/api/order":
        return {"oneOf": [_order(kind) for kind in NEEDS]}
    return _object(BODIES.get(path, {}))


def _order(kind: str) -> Json:
    """Return the schema of an order, with the role that it needs."""
    if kind in OF_THE_DESK:
        keys, required = OF_THE_DESK[kind], list(OF_THE_DESK[kind])
    else:
        document = DOCUMENTS.get(kind) or ORDERS[kind].keys
        keys, required = _properties(document), _keys_without_default(document)
    found = _object({"do": {"const": kind}, **keys})
    return {**found, "required": ["do", *required], "description": f"Needs the role {NEEDS[kind].word}."}


def _object(properties: Json) -> Json:
    return {"type": "object", "properties": properties}


def _keys_without_default(kind: Any) -> list[str]:
    return [str(item.metadata.get("key", item.name)) for item in fields(kind) if item.default is MISSING]


def _properties(kind: Any) -> Json:
    hints = get_type_hints(kind, include_extras=True)
    return {str(item.metadata.get("key", item.name)): _schema(hints[item.name]) for item in fields(kind)}


def _schema(kind: Any) -> Json:
    """Return the schema of a field's type."""
    if get_origin(kind) is Annotated:
        inner, rule = get_args(kind)
        if rule.choices:
            return {"enum": list(rule.choices)}
        return _schema(inner) | _bounds(rule, get_origin(inner) is tuple, inner is str)
    if get_origin(kind) is tuple:
        return {"type": "array", "items": _schema(get_args(kind)[0])}
    if type(None) in get_args(kind):
        return {"anyOf": [_schema(get_args(kind)[0]), {"type": "null"}]}
    if get_origin(kind) is Literal:
        return {"enum": list(get_args(kind))}
    if isinstance(kind, type) and issubclass(kind, Enum):
        return {"enum": [each.value for each in kind]}
    if isinstance(kind, type) and issubclass(kind, CheckedDocument):
        return {**_object(_properties(kind)), "required": _keys_without_default(kind)}
    return {float: NUMBER, int: WHOLE, str: TEXT, bool: {"type": "boolean"}}.get(kind, {"type": "object"})


def _bounds(rule: Rule, is_list: bool, is_text: bool) -> Json:
    if is_list:
        return {"minItems": rule.least, "maxItems": rule.most}
    if is_text:
        return {"maxLength": rule.most}
    found = {"minimum": rule.low, "maximum": rule.high}
    return {name: bound for name, bound in found.items() if abs(bound) != float("inf")}


if __name__ == "__main__":
    print(json.dumps(openapi(), indent=1))
