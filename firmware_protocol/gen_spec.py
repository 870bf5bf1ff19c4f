"""messages.yaml as checked values: what both generators need."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

SOURCE = Path(__file__).parent / "messages.yaml"


@dataclass(frozen=True, slots=True)
class FieldSpec:
    """One field of messages.yaml with everything derived that both languages need."""

    name: str
    type: str
    low: int  # raw
    high: int  # raw
    per_unit: int | None
    none: int | None
    enum: str | None
    bits: bool
    unit: str
    doc: str

    @property
    def wire(self) -> str:
        """Integer type on the wire."""
        return "u8" if self.type == "bool" else self.type


@dataclass(frozen=True, slots=True)
class MessageSpec:
    """One message of messages.yaml."""

    name: str
    class_name: str
    kind: int
    from_board: bool
    fields: tuple[FieldSpec, ...]

    @property
    def length(self) -> int:
        """Length of the body [bytes]."""
        return sum(width(field.wire) for field in self.fields)


@dataclass(frozen=True, slots=True)
class Spec:
    """The whole of messages.yaml, checked."""

    version: int
    max_body: int
    enums: dict[str, dict[str, int]]
    capabilities: dict[str, int]
    docs: dict[str, str]  # of each enum by its name, and of `capabilities`
    messages: tuple[MessageSpec, ...]


def read_spec(path: Path = SOURCE) -> Spec:
    """messages.yaml as values. Raises ValueError on what neither language could carry."""
    raw = yaml.safe_load(path.read_text(encoding="utf-8"))
    for name, members in raw["enums"].items():
        if list(members.values()) != list(range(len(members))):
            raise ValueError(f"{path.name}: enums.{name}: values must be 0, 1, 2 ...")
    for name in (*raw["enums"], "capabilities"):
        if not raw["docs"].get(name):
            raise ValueError(f"{path.name}: docs: missing key '{name}'")
    messages = tuple(_message(name, body, raw["enums"]) for name, body in raw["messages"].items())
    for message in messages:
        if message.length > raw["max_body"]:
            raise ValueError(f"{path.name}: messages.{message.name}: longer than max_body")
    if len({message.kind for message in messages}) != len(messages):
        raise ValueError(f"{path.name}: messages: two have the same id")
    enums, capabilities, docs = raw["enums"], raw["capabilities"], raw["docs"]
    return Spec(raw["protocol_version"], raw["max_body"], enums, capabilities, docs, messages)


def _message(name: str, raw: dict[str, Any], enums: dict[str, dict[str, int]]) -> MessageSpec:
    fields = tuple(_field(field, enums) for field in raw["fields"])
    return MessageSpec(name, raw.get("class", camel(name)), raw["id"], raw["from"] == "board", fields)


def _field(raw: dict[str, Any], enums: dict[str, dict[str, int]]) -> FieldSpec:
    wire = "u8" if raw["type"] == "bool" else raw["type"]
    per_unit = round(1 / raw["scale"]) if "scale" in raw else None
    low, high = wire_limits(wire)
    if "range" in raw:
        low, high = (round(limit * (per_unit or 1)) for limit in raw["range"])
    elif "enum" in raw:
        high = len(enums[raw["enum"]]) - 1
    elif raw["type"] == "bool":
        high = 1
    return FieldSpec(
        raw["name"], raw["type"], low, high, per_unit, raw.get("none"), raw.get("enum"),
        "bits" in raw, raw.get("unit", ""), raw.get("doc", ""),
    )  # fmt: skip


def width(wire: str) -> int:
    """Bytes of a type on the wire."""
    return int(wire[1:]) // 8


def wire_limits(wire: str) -> tuple[int, int]:
    """Smallest and largest integer of a type on the wire."""
    bits = int(wire[1:])
    return (0, 2**bits - 1) if wire[0] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def camel(name: str) -> str:
    """reset_cause -> ResetCause."""
    return "".join(part.capitalize() for part in name.split("_"))
