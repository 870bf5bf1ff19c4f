"""Bounded reading of input files: regular files only, and never more bytes than the caller expects."""

import errno
import os
import stat
from pathlib import Path

SMALL = 1 << 20  # settings, states, manifests, keys, reports [bytes]
TABLE = 64 << 20  # run files; a year of minutes has 20 MB [bytes]


def read_file(path: Path, most: int = SMALL) -> bytes:
    """Return the content of `path`. Errors: OSError, also for a FIFO, a device, more than `most` bytes."""
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "a NUL in the path")
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # opening a FIFO would wait
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "not a regular file")
    with os.fdopen(descriptor, "rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"larger than {most >> 10} kB")
    return content


def read_text(path: Path, most: int = SMALL) -> str:
    """Return the content of `path` as UTF-8 text. Errors: OSError as `read_file`; another encoding."""
    try:
        return read_file(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, f"not UTF-8 at byte {error.start}") from None
