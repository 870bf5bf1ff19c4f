"""edge.yaml becomes checked, frozen settings, once. Nobody passes dicts on."""

import hashlib
import json
from dataclasses import asdict, fields
from datetime import time
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import yaml

from edge.config.settings import Settings
from edge.core.errors import ConfigError
from edge.core.plain_text import shown
from edge.formats.checked import Section, SettingError, nearest, value_problem
from edge.formats.input_file import YAML, read_text
from edge.formats.strict_yaml import parse_yaml

AnySection = TypeVar("AnySection", bound=Section)


def default() -> Settings:
    """Settings of an empty file."""
    return Settings()


def load(path: str | Path) -> Settings:
    """Settings from a YAML file. Raises ConfigError, which names file and key."""
    try:
        source = read_text(Path(path), YAML)
    except OSError as error:
        raise ConfigError(f"{path}: can't be read: {error.strerror}") from error
    return parse(source, str(path))


def parse(source: str, place: str = "edge.yaml") -> Settings:
    """Settings from YAML text; `place` is named in errors."""
    try:
        tree = parse_yaml(source)
    except yaml.YAMLError as error:
        raise ConfigError(f"{place}: {error}") from error
    wrong: list[SettingError] = []
    settings = _section(Settings, tree, "", wrong)
    if wrong:
        raise ConfigError("\n".join(f"{place}: {error}" for error in wrong))
    return settings


def config_hash(settings: Settings) -> str:
    """Short name of these settings, equal for equal settings however their YAML was written."""
    text = json.dumps(asdict(settings), default=str, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _section(kind: type[AnySection], tree: object, key: str, wrong: list[SettingError]) -> AnySection:
    """One section from a mapping; a missing key keeps its default, an empty section is all defaults.

    wrong : takes every problem; with a new one the returned section means nothing
    """
    before = len(wrong)
    if not isinstance(tree, dict | None):
        wrong.append(SettingError(key or "the file", f"must hold keys and values, not {shown(tree)}"))
        return kind()
    types = get_type_hints(kind)
    known = {item.name: item.metadata.get("rule") for item in fields(kind)}
    values = {}
    for name, value in (tree or {}).items():
        if name not in known:
            problem = f"unknown key {shown(name)}; {nearest(str(name), known)}"
            wrong.append(SettingError(key or "the file", problem))
            continue
        place = _join(key, name)
        try:
            values[name] = _value(types[name], value, place, wrong)
        except SettingError as error:
            wrong.append(error)
        else:
            if problem := value_problem(values[name], known[name]):
                wrong.append(SettingError(place, problem))
    if len(wrong) > before:
        return kind()
    try:
        return kind(**values)
    except SettingError as error:
        wrong.append(SettingError(_join(key, error.key), error.problem))
        return kind()


def _value(kind: Any, value: object, key: str, wrong: list[SettingError]) -> Any:
    """`value` as the type a field asks for; never a guess between types."""
    if get_origin(kind) is tuple:
        return _list(get_args(kind)[0], value, key, wrong)
    if issubclass(kind, Section):
        return _section(kind, value, key, wrong)
    if kind is time:
        return _time(value, key)
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is not kind:
        raise SettingError(key, f"must be {_WORDS[kind]}, not {shown(value)}")
    return value


_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text", time: '"HH:MM"'}


def _list(
    kind: type[AnySection], value: object, key: str, wrong: list[SettingError]
) -> tuple[AnySection, ...]:
    if not isinstance(value, list):
        raise SettingError(key, f"must be a list, not {shown(value)}")
    return tuple(_section(kind, item, f"{key}[{index}]", wrong) for index, item in enumerate(value))


def _time(value: object, key: str) -> time:
    try:
        result = time.fromisoformat(value) if isinstance(value, str) else None
    except ValueError:
        result = None
    if result is None or result.tzinfo is not None:
        raise SettingError(key, f"must be {_WORDS[time]}, not {shown(value)}")
    return result


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else str(name)
