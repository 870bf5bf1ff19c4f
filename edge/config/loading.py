"""edge.yaml becomes checked, frozen settings, once. Nobody passes dicts on."""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

from edge.config.settings import Settings
from edge.core.errors import ConfigError
from edge.formats.reader import DocumentError, parse_yaml, read, read_yaml


def default() -> Settings:
    """Settings of an empty file."""
    return Settings()


def load(path: str | Path) -> Settings:
    """Settings from a YAML file. Raises ConfigError, which names file and key."""
    try:
        return read_yaml(Settings, Path(path))
    except DocumentError as error:
        raise ConfigError(str(error)) from error


def parse(source: str, place: str = "edge.yaml") -> Settings:
    """Settings from YAML text; `place` is named in errors."""
    try:
        return read(Settings, parse_yaml(source, place), place, null_is_empty=True)
    except DocumentError as error:
        raise ConfigError(str(error)) from error


def config_hash(settings: Settings) -> str:
    """Short name of these settings, equal for equal settings however their YAML was written."""
    text = json.dumps(asdict(settings), default=str, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
