"""Files that a command writes."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edge.core.errors import DataError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Report a file that cannot be written in one line. Errors: DataError"""
    try:
        yield
    except OSError as error:
        raise DataError(f"{path}: can't be written: {error.strerror or error}") from error
