"""Compile once for all workers of a test session and the boards that they start."""

import atexit
import fcntl
import functools
import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

FOLDER_VARIABLE = "GREENHOUSE_TEST_BUILDS"  # set by tests/conftest.py


def built(name: str, build: Callable[[Path], object], sources: Iterable[Path]) -> Path:
    """Return the file that `build` writes to the path it is given, or has written from the same sources."""
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sorted(sources)))
    target = _folder() / digest.hexdigest()[:16] / name
    target.parent.mkdir(exist_ok=True)
    with target.with_name(f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not target.exists():
            part = target.with_name(f"part-{name}")
            build(part)
            part.rename(target)
    return target


@functools.cache
def _folder() -> Path:
    """Return the session's folder; a process outside of a session has one of its own."""
    if FOLDER_VARIABLE in os.environ:
        return Path(os.environ[FOLDER_VARIABLE])
    own = tempfile.TemporaryDirectory(prefix="greenhouse-builds-")
    atexit.register(own.cleanup)
    return Path(own.name)
