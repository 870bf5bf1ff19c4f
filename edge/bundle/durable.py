"""Files that are on the disk, not only in the system's memory, when a call returns."""

import os
from collections.abc import Iterable
from pathlib import Path


def write_new(path: Path, chunks: Iterable[bytes]) -> None:
    """A file that was not there before, written through to the disk. Errors: OSError"""
    with path.open("xb") as file:
        for chunk in chunks:
            file.write(chunk)
        file.flush()
        os.fsync(file.fileno())


def sync_folder(path: Path) -> None:
    """Names in a folder outlive a power cut only after this. Errors: OSError"""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(path: Path) -> None:
    """`path` and what lacks above it, each written through. Errors: OSError"""
    if path.is_dir():
        return
    make_folder(path.parent)
    path.mkdir(exist_ok=True)
    sync_folder(path.parent)


def move(path: Path, target: Path) -> None:
    """Rename within one folder, so that after a power cut it has happened wholly or not. Errors: OSError"""
    path.rename(target)
    sync_folder(target.parent)
