"""The one reader of every document: a dataclass says what is allowed, `read` makes one of it or refuses.

Everything wrong is found at once and named by file and place. Refused everywhere, by this code: unknown and
missing keys, a key twice, NaN and infinity, true and false as numbers, numbers as text, a document that is
too deep or too large.

A class's fields may be bool, int, float, str, time, Any, Literal, Enum, X | None, tuple, Mapping and further
dataclasses; `Annotated[float, Rule(...)]` bounds one. A field without a default is required, and one with the
metadata `required`; the metadata `key` names the document's key where Python reserves the word.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from datetime import time
from enum import Enum
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import yaml

from edge.core.errors import DataError
from edge.core.plain_text import plain, quote
from edge.formats import parsing
from edge.formats.cross_check import CheckedDocument, Rule, SettingError, nearest, value_problem
from edge.formats.input_file import SMALL, YAML, Source, read_file, read_text

SHOWN_MAX = 4  # problems that one line names

Document = TypeVar("Document")
Problem = tuple[str, str]  # key, why


class Foreign:
    """Base of a class for documents of others' software: keys that they have in addition are ignored."""

    __slots__ = ()


class DocumentError(DataError):
    """A document that can't be read, in one line: `twin.yaml: effects.wall_loss.UA: missing; sample_s: ...`.

    problems : each with its key, without the file's name
    """

    def __init__(self, place: str, problems: Sequence[Problem]) -> None:
        self.named = tuple(problems)
        self.problems = [f"{key}: {problem}" if key else problem for key, problem in problems]
        more = len(problems) - SHOWN_MAX
        text = "; ".join(self.problems[:SHOWN_MAX]) + (f"; and {more} more" if more > 0 else "")
        super().__init__(f"{place}: {text}" if place else text)


def read(
    kind: type[Document], document: object, place: str = "", key: str = "", null_is_empty: bool = False
) -> Document:
    """Return `document`, as a parser gives it, as an object of `kind`.

    place : named first in an error, the file's name
    key : where in the file the document stands, "" for the whole of it
    null_is_empty : null stands for a mapping without keys, as a key without a value does in YAML
    Errors : DocumentError
    """
    reading = _Reading(null_is_empty)
    found: Document = reading.value(kind, document, key)
    if reading.wrong:
        raise DocumentError(place, reading.wrong)
    return found


def read_number(
    document: object, key: str, low: float = -math.inf, high: float = math.inf, above: float = -math.inf
) -> float:
    """Return a finite number within bounds that only the caller knows. Errors: DocumentError"""
    value = read(float, document, key=key)
    if problem := value_problem(value, Rule(low=low, high=high, above=above)):
        raise DocumentError("", [(key, problem)])
    return value


def parse_json(content: bytes | str, place: str = "", most: int = SMALL) -> dict[str, Any]:
    """Return the JSON object in `content` of at most `most` bytes or characters. Errors: DocumentError"""
    if len(content) > most:
        raise DocumentError(place, [("", f"larger than {most >> 10} kB")])
    try:
        return parsing.parse_object(content)
    except ValueError as error:
        raise DocumentError(place, [("", f"not JSON: {error}")]) from None


def parse_yaml(text: str, place: str = "") -> Any:
    """Return the values of one YAML document. Errors: DocumentError"""
    if len(text) > YAML:
        raise DocumentError(place, [("", f"larger than {YAML >> 10} kB")])
    try:
        return parsing.parse_yaml(text)
    except yaml.YAMLError as error:
        raise DocumentError(place, [("", f"not YAML: {error}")]) from None


def read_json(kind: type[Document], path: Source, most: int = SMALL) -> Document:
    """Return a JSON file as an object of `kind`. Errors: DocumentError, also for a file that can't be read"""
    return read(kind, parse_json(read_bytes(path, most), str(path), most), str(path))


def read_yaml(kind: type[Document], path: Source) -> Document:
    """Return a YAML file as an object of `kind`. Errors: DocumentError, also for a file that can't be read"""
    try:
        text = read_text(path, YAML)
    except OSError as error:
        raise _unreadable(path, error) from error
    return read(kind, parse_yaml(text, str(path)), str(path), null_is_empty=True)


def read_bytes(path: Source, most: int = SMALL) -> bytes:
    """Return the content of `path`. Errors: DocumentError where it can't be read or is larger than `most`"""
    try:
        return read_file(path, most)
    except OSError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Source, error: OSError) -> DocumentError:
    return DocumentError(str(path), [("", f"cannot be read: {error.strerror}")])


def _below(key: str, name: object) -> str:
    return f"{key}.{name}" if key else str(name)


@dataclass(frozen=True, slots=True)
class _Entry:
    """One key of a dataclass."""

    name: str
    kind: Any
    rule: Rule | None
    required: bool


@cache
def _entries(kind: Any) -> dict[str, _Entry]:
    """Return the document's keys of a dataclass."""
    types = get_type_hints(kind, include_extras=True)
    found = {}
    for item in fields(kind):
        note = item.metadata
        has_default = item.default is not MISSING or item.default_factory is not MISSING
        required = note.get("required", not has_default)
        found[note.get("key", item.name)] = _Entry(item.name, types[item.name], note.get("rule"), required)
    return found


_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text", time: '"HH:MM"'}


class _Reading:
    """One document under the reader. A value with a problem means nothing; `wrong` takes the problem."""

    def __init__(self, null_is_empty: bool) -> None:
        self.wrong: list[Problem] = []
        self._null_is_empty = null_is_empty

    def value(self, kind: Any, value: object, key: str, rule: Rule | None = None) -> Any:
        """`value` as the type that a field asks for; never a guess between types."""
        if get_origin(kind) is Annotated:
            kind, rule = get_args(kind)
        before = len(self.wrong)
        found = self._type_value(kind, value, key)
        if len(self.wrong) == before and (problem := value_problem(found, rule)):
            self._refuse(key, problem)
        return found

    def _refuse(self, key: str, problem: str) -> None:
        self.wrong.append((key, problem))

    def _refuse_key(self, key: str, name: object, known: Iterable[str]) -> None:
        self._refuse(key, f"unknown key {quote(name)}; {nearest(str(name), known)}")

    def _type_value(self, kind: Any, value: object, key: str) -> Any:
        if kind is Any:
            return value
        if reader := _BY_ORIGIN.get(get_origin(kind)):
            return reader(self, kind, value, key)
        if is_dataclass(kind):
            return self._section(kind, value, key)
        if kind is float:
            return self._number(value, key)
        if kind is time:
            return self._time(value, key)
        if issubclass(kind, Enum):
            return self._choice({item.value: item for item in kind}, value, key)
        if type(value) is not kind:
            self._refuse(key, f"must be {_WORDS[kind]}, not {quote(value)}")
        return value

    def _number(self, value: object, key: str) -> float:
        try:
            number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
        except OverflowError:
            number = math.inf
        if number is None:
            self._refuse(key, f"must be a number, not {quote(value)}")
        elif not math.isfinite(number):
            self._refuse(key, f"{quote(value)} is not a finite number")
        return 0.0 if number is None else number

    def _time(self, value: object, key: str) -> time | None:
        try:
            found = time.fromisoformat(value) if isinstance(value, str) else None
        except ValueError:
            found = None
        if found is None or found.tzinfo is not None:
            self._refuse(key, f"must be {_WORDS[time]}, not {quote(value)}")
        return found

    def _choice(self, known: Mapping[Any, Any], value: object, key: str) -> Any:
        for choice, meaning in known.items():
            if type(choice) is type(value) and choice == value:
                return meaning
        if len(known) == 1:
            self._refuse(key, f"{quote(value)} is not {next(iter(known))!r}")
        else:
            self._refuse(key, f"{quote(value)} is none of {', '.join(map(str, known))}")
        return None

    def _literal(self, kind: Any, value: object, key: str) -> Any:
        return self._choice({choice: choice for choice in get_args(kind)}, value, key)

    def _optional(self, kind: Any, value: object, key: str) -> Any:
        (other,) = [part for part in get_args(kind) if part is not type(None)]
        return None if value is None else self.value(other, value, key)

    def _tuple(self, kind: Any, value: object, key: str) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple):
            self._refuse(key, f"must be a list, not {quote(value)}")
            return ()
        kinds = get_args(kind)
        if kinds[0] is float and all(type(item) is float and math.isfinite(item) for item in value):
            kinds = (Any, *kinds[1:])  # nothing is wrong with any of them; arrays are large
        if kinds[-1] is Ellipsis:
            return tuple(self.value(kinds[0], item, f"{key}[{place}]") for place, item in enumerate(value))
        if len(value) != len(kinds):
            self._refuse(key, f"must be a list of {len(kinds)}, not {quote(value)}")
            return ()
        pairs = enumerate(zip(kinds, value, strict=True))
        return tuple(self.value(own, item, f"{key}[{place}]") for place, (own, item) in pairs)

    def _mapping(self, kind: Any, value: object, key: str) -> dict[Any, Any]:
        names, kinds = get_args(kind)
        rule = next((note for note in get_args(names) if isinstance(note, Rule)), Rule())
        found = {}
        for name, item in self._keys(value, key).items():
            if rule.choices and name not in rule.choices:
                self._refuse_key(key, name, rule.choices)
                continue
            before, place = len(self.wrong), _below(key, plain(str(name), 40))
            known = self.value(names, name, place)
            if len(self.wrong) == before:
                found[known] = self.value(kinds, item, place)
        return found

    def _section(self, kind: Any, value: object, key: str) -> Any:
        before, entries, given = len(self.wrong), _entries(kind), self._keys(value, key)
        for name in given:
            if name not in entries and not issubclass(kind, Foreign):
                self._refuse_key(key, name, entries)
        # A key that is misspelt is not missing too: one mistake, one message.
        if len(self.wrong) == before:
            for name, entry in entries.items():
                if entry.required and name not in given:
                    self._refuse(_below(key, name), "missing")
        values = {
            entry.name: self.value(entry.kind, given[name], _below(key, name), entry.rule)
            for name, entry in entries.items()
            if name in given
        }
        if len(self.wrong) > before:
            return None
        try:
            found = kind(**values)
            if isinstance(found, CheckedDocument):
                found.cross_check()
            return found
        except SettingError as error:
            self._refuse(_below(key, error.key) if error.key else key, error.problem)
        except DocumentError as error:
            self.wrong += [(_below(key, problem_key), why) for problem_key, why in error.named]
            return None

    def _keys(self, value: object, key: str) -> Mapping[Any, Any]:
        if isinstance(value, Mapping):
            return value
        if value is not None or not self._null_is_empty:
            self._refuse(key, f"must hold keys and values, not {quote(value)}")
        return {}


_BY_ORIGIN: dict[Any, Callable[[_Reading, Any, object, str], Any]] = {
    Union: _Reading._optional,
    UnionType: _Reading._optional,
    Literal: _Reading._literal,
    tuple: _Reading._tuple,
    Mapping: _Reading._mapping,
    dict: _Reading._mapping,
}
