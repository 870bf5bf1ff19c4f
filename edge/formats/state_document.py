"""A small JSON object that survives a restart: read strictly, written whole."""

import json
from pathlib import Path
from typing import Any

from edge.core.errors import DataError
from edge.formats.atomic_file import write_atomically
from edge.formats.input_file import read_file
from edge.formats.strict_json import parse_object


def read_document(path: Path) -> dict[str, Any] | None:
    """Return the object that was written last, None without a file. Errors: DataError, which names `path`"""
    try:
        return parse_object(read_file(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error


def write_document(path: Path, values: dict[str, Any]) -> None:
    """Replace the file whole. Errors: OSError."""
    if not path.is_file():  # a FIFO, or a link to a device, would swallow the values
        path.unlink(missing_ok=True)
    write_atomically(path, json.dumps(values, indent=1))
