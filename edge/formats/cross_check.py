"""How a document's class says what it allows, and the check that holds a value to that.

A class is a frozen dataclass. Each field carries unit, range and meaning in its metadata (`number`, `whole`,
`text`, ...) or in its type (`Annotated[float, Rule(above=0.0)]`). The check of a `Section` also runs when an
object is made, so a setting from code is held to the same limits as one from YAML.
"""

import difflib
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from datetime import time
from typing import Any, NoReturn

from edge.core.errors import ConfigError
from edge.core.plain_text import quote

REQUIRED = {"required": True}  # metadata: in a document, though an object made in code has a default
ABSENT: Any = None  # default of a key that may be left out of a document but not be null
TEXT_MAX = 4096  # of a value; the longest path of Linux
Form = Callable[[str], str] | None
KEY_MAX = 100  # of a misspelt key that is compared with the known ones


@dataclass(frozen=True, slots=True)
class Rule:
    """The rule of one key. `hard`: the upper bound stands in edge/core/hard_limits.py."""

    doc: str = ""
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    hard: bool = False
    choices: tuple[Any, ...] = ()
    pattern: str = ""
    example: str = ""  # YAML of one item, for lists that are empty by default
    above: float = -math.inf  # a lower bound that is not allowed itself
    most: int = 0  # characters or items; 0: TEXT_MAX characters, any number of items
    least: int = 0
    form: Form = None  # why a text, or one of a list, is not allowed


class SettingError(ConfigError):
    """A value a section can't have; `key` is relative to that section."""

    def __init__(self, key: str, problem: str) -> None:
        super().__init__(f"{key}: {problem}")
        self.key = key
        self.problem = problem


class CheckedDocument:
    """Base of a document's class with a check of its values against each other."""

    __slots__ = ()

    def cross_check(self) -> None:
        """Check the conditions between the values, on reading; a subclass overrides it."""

    def refuse(self, key: str, problem: str) -> NoReturn:
        """Raise with the place named."""
        raise SettingError(key, problem)


@dataclass(frozen=True, slots=True)
class Section(CheckedDocument):
    """Base of all settings. Raises SettingError when made with a value its rules do not allow."""

    def __post_init__(self) -> None:
        for item in fields(self):
            problem = value_problem(getattr(self, item.name), item.metadata.get("rule"))
            if problem:
                self.refuse(item.name, problem)
        self.cross_check()


def number(default: float, doc: str, unit: str, low: float, high: float, hard: bool = False) -> Any:
    """Declare a real number; its key carries the unit."""
    return _field(default, Rule(doc, unit, low, high, hard))


def whole(default: int, doc: str, low: int, high: int, choices: tuple[int, ...] = ()) -> Any:
    """Declare a whole number."""
    return _field(default, Rule(doc, "", low, high, choices=choices))


def text(default: str, doc: str, choices: tuple[str, ...] = (), pattern: str = "", form: Form = None) -> Any:
    """Declare a string: one of `choices`, wholly matched by `pattern`, of a `form`, where given."""
    return _field(default, Rule(doc, choices=choices, pattern=pattern, form=form))


def flag(default: bool, doc: str) -> Any:
    """Declare a value of true or false."""
    return _field(default, Rule(doc))


def clock(default: str, doc: str) -> Any:
    """Declare a local time of day, "HH:MM"."""
    return _field(time.fromisoformat(default), Rule(doc, "local time"))


def items(doc: str, example: str, form: Form = None) -> Any:
    """Declare a list of sections or texts, empty by default."""
    return _field((), Rule(doc, example=example, form=form))


def _field(default: Any, rule: Rule) -> Any:
    return field(default=default, metadata={"rule": rule})


def value_problem(value: object, rule: Rule | None) -> str:
    """Why `value` breaks `rule`, "" if it does not. Types are checked where a document is read."""
    if rule is None or value is None:
        return ""
    if rule.choices and value not in rule.choices:
        return f"{quote(value)} is none of {', '.join(str(choice) for choice in rule.choices)}"
    if isinstance(value, int | float) and not isinstance(value, bool):
        return _number_problem(value, rule)
    if isinstance(value, str):
        return _text_problem(value, rule)
    if isinstance(value, tuple | Mapping) and not rule.least <= len(value) <= (rule.most or len(value)):
        bounds = f"{rule.least} to {rule.most}" if rule.most else f"at least {rule.least}"
        return f"must hold {bounds}, not {len(value)}"
    if isinstance(value, tuple) and rule.form:
        return next(filter(None, map(rule.form, value)), "")
    return ""


def _text_problem(value: str, rule: Rule) -> str:
    most = rule.most or TEXT_MAX
    if len(value) > most or not value.isprintable():
        return f"{quote(value)} is longer than {most} characters or has some that are not printable"
    if rule.pattern and not re.fullmatch(rule.pattern, value):
        return f"{quote(value)} does not match {rule.pattern}"
    return rule.form(value) if rule.form else ""


def _number_problem(value: float, rule: Rule) -> str:
    try:
        is_finite = math.isfinite(value)
    except OverflowError:  # a whole number with more digits than a float has
        is_finite = False
    if not is_finite:
        return f"{quote(value)} is not a finite number"
    if value > rule.high:
        return f"{value:g} is above the {'hard limit' if rule.hard else 'largest allowed,'} {rule.high:g}"
    if value < rule.low:
        return f"{value:g} is below the smallest allowed, {rule.low:g}"
    return "" if value > rule.above else f"{value:g} is not above {rule.above:g}"


def nearest(key: str, known: Iterable[str]) -> str:
    """Return a hint for a misspelt key: the nearest known one, or all of them."""
    names = sorted(known)
    if not names:
        return "it takes none"
    close = difflib.get_close_matches(key[:KEY_MAX], names, n=1)
    return f"did you mean {close[0]!r}?" if close else f"known keys: {', '.join(names)}"
