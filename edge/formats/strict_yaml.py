"""YAML as people mean it: no key twice, `on` and `off` are words, 22:00 is no number in base 60.

Depth, digits and the number of values are limited before any value is made.
"""

import re
from collections.abc import Hashable
from typing import Any

import yaml

from edge.core.plain_text import plain, quote
from edge.formats.strict_json import DEPTH_MAX, DIGITS_MAX

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
            _refuse(f"the tag {quote(event.tag)}: values have no tags here", event)
        self._depth += 1
        if self._depth > DEPTH_MAX:
            _refuse("nested too deep", event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(event, yaml.AliasEvent):
            if node not in self._sizes:
                _refuse("an alias inside of what it stands for", event)
        elif isinstance(node, yaml.MappingNode):
            self._sizes[node] = 1 + sum(self._sizes[key] + self._sizes[value] for key, value in node.value)
        elif isinstance(node, yaml.SequenceNode):
            self._sizes[node] = 1 + sum(self._sizes[item] for item in node.value)
        elif node is not None:
            self._sizes[node] = 1
        if len(self._sizes) > VALUES_MAX or (node is not None and self._sizes[node] > VALUES_MAX):
            _refuse(f"more than {VALUES_MAX} values", event)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """As in PyYAML, which would let the last of two equal keys win."""
        seen: set[str] = set()
        for key_node, _ in node.value:
            key = str(key_node.value)
            if key in seen:
                _refuse(f"key {quote(key)} is given twice", key_node)
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """Read a whole number in base 10, also with leading zeros; PyYAML takes 010 for 8."""
        if len(node.value) > DIGITS_MAX:
            _refuse(f"a whole number of {len(node.value)} digits", node)
        return int(node.value)


def _refuse(problem: str, where: Any) -> None:
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
