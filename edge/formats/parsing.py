"""JSON and YAML from outside: no key twice, finite numbers, storable text, bounded depth.

YAML as people mean it: `on` and `off` are words, 22:00 is not a number in base 60. Only ValueError is raised.
"""

import json
import math
import re
from collections.abc import Hashable
from typing import Any, NoReturn

import yaml

from edge.core.plain_text import plain, quote, storable

DEPTH_MAX = 64  # far below the recursion limit, so that every value can be written and printed again
DIGITS_MAX = 300  # of a whole number; one of more does not fit into a float


def parse_object(text: bytes | str) -> dict[str, Any]:
    """Parse an object. Errors: ValueError, whose text may be shown to the sender"""
    try:
        value = _clean(
            json.loads(
                text, object_pairs_hook=_object, parse_constant=_refuse, parse_float=_float, parse_int=_int
            ),
            1,
        )
    except RecursionError:  # a kilobyte of "[" is enough
        raise ValueError("nested too deep") from None
    except UnicodeDecodeError:
        raise ValueError("not UTF-8") from None
    except ValueError as error:
        raise ValueError(plain(str(error))) from None
    if not isinstance(value, dict):
        raise ValueError("not a JSON object")
    return value


def _clean(value: Any, depth: int) -> Any:
    """Return the value with storable texts: "\\ud800" is JSON, but no storable text."""
    if isinstance(value, str):
        return storable(value)
    if isinstance(value, list | dict) and depth > DEPTH_MAX:
        raise ValueError("nested too deep")
    if isinstance(value, list):
        return [_clean(item, depth + 1) for item in value]
    if isinstance(value, dict):
        return _object([(storable(key), _clean(item, depth + 1)) for key, item in value.items()])
    return value


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """As Python does it, which would let the last of two equal keys win."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"key {quote(twice)} is given twice")
    return found


def _float(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits} is too large")
    return value


def _int(digits: str) -> int:
    if len(digits) > DIGITS_MAX:
        raise ValueError(f"a whole number of {len(digits)} digits")
    return int(digits)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")


VALUES_MAX = 20_000  # of one document; the largest of this project has some hundreds


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader with the scalars of YAML 1.2 (PyYAML's own are those of 1.1)."""

    yaml_implicit_resolvers = {}  # noqa: RUF012  PyYAML's name; filled below

    def __init__(self, source: str) -> None:
        super().__init__(source)
        self._depth = 0
        self._sizes: dict[yaml.Node, int] = {}  # values in each finished node, aliases written out

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """As in PyYAML, with limits. An alias counts as the values that it stands for."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if getattr(event, "tag", None) is not None:
            _refuse_yaml(f"the tag {quote(event.tag)}: values have no tags here", event)
        self._depth += 1
        if self._depth > DEPTH_MAX:
            _refuse_yaml("nested too deep", event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(event, yaml.AliasEvent):
            if node not in self._sizes:
                _refuse_yaml("an alias inside of what it stands for", event)
        elif isinstance(node, yaml.MappingNode):
            self._sizes[node] = 1 + sum(self._sizes[key] + self._sizes[value] for key, value in node.value)
        elif isinstance(node, yaml.SequenceNode):
            self._sizes[node] = 1 + sum(self._sizes[item] for item in node.value)
        elif node is not None:
            self._sizes[node] = 1
        if len(self._sizes) > VALUES_MAX or (node is not None and self._sizes[node] > VALUES_MAX):
            _refuse_yaml(f"more than {VALUES_MAX} values", event)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """As in PyYAML, which would let the last of two equal keys win."""
        seen: set[str] = set()
        for key_node, _ in node.value:
            key = str(key_node.value)
            if key in seen:
                _refuse_yaml(f"key {quote(key)} is given twice", key_node)
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """Read a whole number in base 10, also with leading zeros; PyYAML takes 010 for 8."""
        if len(node.value) > DIGITS_MAX:
            _refuse_yaml(f"a whole number of {len(node.value)} digits", node)
        return int(node.value)


def _refuse_yaml(problem: str, where: Any) -> None:
    """Raise at the place of a node or an event."""
    raise yaml.constructor.ConstructorError(None, None, problem, where.start_mark)


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)
for _tag, _pattern, _first in (
    ("bool", r"true|True|false|False", "tTfF"),
    ("null", r"~|null|Null|", "~nN"),
    ("int", r"[-+]?[0-9]+", "-+0123456789"),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.inf|\.nan", "-+0123456789."),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"), [*_first])
_Loader.add_implicit_resolver("tag:yaml.org,2002:null", re.compile(r"^$"), [""])


def parse_yaml(source: str) -> Any:
    """Return plain values of one YAML document. Errors: yaml.YAMLError, its text one line fit to be shown."""
    try:
        return yaml.load(source, _Loader)  # a SafeLoader
    except RecursionError:  # in the scanner, before a node is there
        raise yaml.YAMLError("nested too deep") from None
    except yaml.YAMLError as error:
        raise yaml.YAMLError(plain(str(error), 300)) from None
