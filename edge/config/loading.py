"""edge.yaml becomes checked, frozen settings, once. Nobody passes dicts on."""

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from edge.config.settings import Settings
from edge.core.errors import ConfigError
from edge.formats.reader import DocumentError, parse_yaml, read, read_yaml


def default() -> Settings:
    """Return the settings of an empty file."""
    return Settings()


def load(path: str | Path) -> Settings:
    """Load settings from a YAML file. Raises ConfigError, which names file and key"""
    with all_problems(path):
        return read_yaml(Settings, Path(path))


def parse(source: str, place: str = "edge.yaml") -> Settings:
    """Parse settings from YAML text; `place` is named in errors."""
    with all_problems(place):
        return read(Settings, parse_yaml(source, place), place, null_is_empty=True)


@contextmanager
def all_problems(place: str | Path) -> Iterator[None]:
    """Report each problem in a line, so that a person corrects them in one go."""
    try:
        yield
    except DocumentError as error:
        raise ConfigError("\n".join(f"{place}: {problem}" for problem in error.problems)) from error


def config_hash(settings: Settings) -> str:
    """Short name of these settings, equal for equal settings however their YAML was written."""
    text = json.dumps(asdict(settings), default=str, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
