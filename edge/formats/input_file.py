"""Bounded reading of input files: regular files only, and never more bytes than the caller expects.

A bundle's files are read once, checked, and handed to the same readers as `MemoryFile`s: what was checked is
what is loaded, whatever happens on the disk meanwhile.
"""

import errno
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from edge.formats.owner import as_owner

YAML = 128 << 10  # the parser takes a second for so much [bytes]
SMALL = 1 << 20  # settings, states, manifests, keys, reports [bytes]
MODEL = 16 << 20  # ten times what a network of this project takes [bytes]
TABLE = 64 << 20  # run files; a year of minutes has 20 MB [bytes]


@dataclass(frozen=True, slots=True)
class MemoryFile:
    """The content of a file that was read before; printed as its path."""

    path: Path
    content: bytes

    @property
    def name(self) -> str:
        """The last part of its path."""
        return self.path.name

    def __str__(self) -> str:
        return str(self.path)


@dataclass(frozen=True, slots=True)
class MemoryFolder:
    """Files of one folder that were read before, by name."""

    path: Path
    files: Mapping[str, bytes]

    def __truediv__(self, name: str) -> MemoryFile:
        return MemoryFile(self.path / name, self.files[name])


Source = Path | MemoryFile
Folder = Path | MemoryFolder


def open_file(path: Path) -> BinaryIO:
    """Open a regular file, for readers that take less than all of it. Errors: OSError, which names it."""
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "a NUL in the path", str(path))
    with as_owner(path):
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # opening a FIFO would wait
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return os.fdopen(descriptor, "rb")


def read_file(path: Source, most: int = SMALL) -> bytes:
    """Return the content of `path`. Errors: OSError, also for a FIFO, a device, more than `most` bytes."""
    if isinstance(path, MemoryFile):
        return path.content
    with open_file(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"larger than {most >> 10} kB")
    return content


def read_text(path: Source, most: int = SMALL) -> str:
    """Return the content of `path` as UTF-8 text. Errors: OSError as `read_file`; another encoding."""
    try:
        return read_file(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, f"not UTF-8 at byte {error.start}") from None
