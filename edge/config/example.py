"""edge.yaml written from settings: the commented example, which this module prints, and a rig's changes."""

import json
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


def changes(settings: Settings) -> str:
    """Return the YAML of the keys that differ from their defaults, with unit and meaning of each."""
    return "".join(f"{line}\n" for line in _changed_lines(settings, Settings(), ""))


def changed_keys(settings: Section, before: Section, key: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield each key that differs, with its value before and now, as YAML."""
    for item in fields(settings):
        old, new, name = getattr(before, item.name), getattr(settings, item.name), f"{key}{item.name}"
        if isinstance(new, Section):
            yield from changed_keys(new, old, f"{name}.")
        elif old != new:
            yield name, _yaml(old), _yaml(new)


def _changed_lines(section: Section, usual: Section, indent: str) -> Iterator[str]:
    for item in fields(section):
        value, default = getattr(section, item.name), getattr(usual, item.name)
        if isinstance(value, Section):
            below = list(_changed_lines(value, default, indent + "  "))
            yield from [f"{indent}{item.name}:", *below] if below else []
        elif value != default:
            rule: Rule = item.metadata["rule"]
            unit = f"[{rule.unit}] " if rule.unit else ""
            yield f"{indent}{item.name}: {_yaml(value)}  # {unit}{rule.doc}"


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
            return json.dumps(value, ensure_ascii=False)  # text of JSON is text of YAML
        case float():
            return repr(value) if "." in repr(value) else f"{value:.17f}".rstrip("0")  # 1e-06 is text in YAML
        case tuple():
            return f"[{', '.join(map(_yaml, value))}]"
        case Section():
            pairs = (f"{item.name}: {_yaml(getattr(value, item.name))}" for item in fields(value))
            return f"{{{', '.join(pairs)}}}"
    return repr(value)


if __name__ == "__main__":
    print(document(Settings()), end="")
