"""A small JSON object that survives a restart: read strictly, written whole."""

import json
from pathlib import Path
from typing import Any

from edge.core.errors import DataError
from edge.formats.atomic_file import write_atomically
from edge.formats.reader import parse_json, read_bytes


def read_document(path: Path) -> dict[str, Any] | None:
    """Return the object that was written last, None without a file. Errors: DataError, which names `path`"""
    try:
        return parse_json(read_bytes(path), str(path))
    except DataError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise


def write_document(path: Path, values: dict[str, Any]) -> None:
    """Replace the file whole. Errors: OSError."""
    if not path.is_file():  # a FIFO, or a link to a device, would swallow the values
        path.unlink(missing_ok=True)
    write_atomically(path, json.dumps(values, indent=1))
