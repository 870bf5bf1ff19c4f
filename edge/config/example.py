"""The commented example of edge.yaml, written from the settings themselves: run this module to print it."""

from collections.abc import Iterator
from dataclasses import Field, fields
from datetime import time
from typing import Any

from edge.config.settings import Settings
from edge.formats.cross_check import Rule, Section

HEAD = """\
# Every key of edge.yaml with its default. Leave out what shall stay as it is; an unknown key is an error.
# Behind each: [unit] smallest..largest, meaning. "hard" limits stand in edge/core/hard_limits.py.
# Printed by: python -m edge.config.example
"""


def document(settings: Settings) -> str:
    """Return `settings` as YAML with unit, range and meaning of every key."""
    return HEAD + "\n".join(_lines(settings, "")) + "\n"


def _lines(section: Section, indent: str) -> Iterator[str]:
    for item in fields(section):
        value = getattr(section, item.name)
        if isinstance(value, Section):
            yield from ([""] if not indent else [])
            yield f"{indent}{item.name}:  # {_summary(value)}"
            yield from _lines(value, indent + "  ")
        else:
            yield f"{indent}{item.name}: {_yaml(value)}  # {_meaning(item)}"


def _summary(section: Section) -> str:
    return (type(section).__doc__ or "").partition("\n")[0].rstrip(".")


def _meaning(item: "Field[Any]") -> str:
    rule: Rule = item.metadata["rule"]
    words = [f"[{rule.unit}]"] if rule.unit else []
    if rule.choices:
        words.append(f"{' | '.join(str(choice) for choice in rule.choices)};")
    elif abs(rule.low) != float("inf"):
        words.append(f"{rule.low:g}..{rule.high:g}{' (hard)' if rule.hard else ''},")
    example = f"; e.g. [{rule.example}]" if rule.example else ""
    return " ".join([*words, rule.doc]) + example


def _yaml(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case time():
            return f'"{value:%H:%M}"'
        case str():
            return f'"{value}"'
        case tuple():
            return "[]"
    return repr(value)


if __name__ == "__main__":
    print(document(Settings()), end="")
