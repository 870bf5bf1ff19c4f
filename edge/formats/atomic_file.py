"""The one writer of files whose loss or half would hurt somebody: states, twins, models, reports, exports.

A kill or a power cut at any moment leaves the file before or the new one, whole. The content is written into
a file without a name, so that a kill leaves nothing else in the folder.
"""

import errno
import fcntl
import json
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from edge.core.errors import DataError
from edge.formats.owner import as_owner
from edge.formats.reader import parse_json, read_bytes

# Answers of file systems and kernels that have no files without a name (NFS, exFAT, an old overlay).
_NEEDS_A_NAME = (errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL)

_PLAIN = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK  # no link is followed, and no FIFO waited for


def write_atomically(path: Path, content: bytes | str) -> None:
    """Replace the file at `path`, on the disk itself when the call returns.

    Mode and owner of the file before are preserved. A link stays, and the file that it points to is
    replaced. A device is written directly, as is a FIFO that somebody reads.

    content : text is written as UTF-8
    Errors : OSError, which names `path`; the file before is untouched then
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        with as_owner(path):
            before = _status(path)
            if before is not None and not stat.S_ISREG(before.st_mode):
                _write_directly(path, data)
            else:
                _replace(Path(os.path.realpath(path)), data, before)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def open_to_overwrite(path: Path, mode: int = 0o640) -> int:
    """Return a descriptor that writes over a regular file in place, made if it is missing. Errors: OSError"""
    make_folder(path.parent)
    with as_owner(path):
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | _PLAIN, mode)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return descriptor


def sync_folder(path: Path) -> None:
    """Names in a folder outlive a power cut only after this. Errors: OSError"""
    descriptor = _open_folder(path)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(path: Path) -> None:
    """Make `path` and missing folders above it, each written through to the disk. Errors: OSError"""
    if path.is_dir():
        return
    make_folder(path.parent)
    with as_owner(path):
        path.mkdir(exist_ok=True)
        sync_folder(path.parent)


def move(path: Path, target: Path) -> None:
    """Rename within one folder, wholly or not at all even in a power cut. Errors: OSError"""
    with as_owner(target):
        path.rename(target)
        sync_folder(target.parent)


@contextmanager
def hold_lock(path: Path, wait: bool = True) -> Iterator[None]:
    """Let one process and thread at a time in; a kill frees the lock. Makes the file and its folder.

    Errors : DataError for what the disk refuses, within the block too; without `wait`, where another holds it
    """
    try:
        make_folder(path.parent)
        with as_owner(path):
            descriptor = os.open(path, os.O_RDONLY | os.O_CREAT | _PLAIN, 0o640)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
        finally:
            os.close(descriptor)
    except OSError as error:
        raise DataError(f"{error.filename or path.parent}: {error.strerror or error}") from error


def _status(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except FileNotFoundError:
        return None


def _write_directly(path: Path, data: bytes) -> None:
    descriptor = os.open(
        path, os.O_WRONLY | os.O_CLOEXEC | os.O_NONBLOCK
    )  # a FIFO without a reader is refused
    os.set_blocking(descriptor, True)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)


def _open_folder(path: Path) -> int:
    return os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)


def _replace(target: Path, data: bytes, before: os.stat_result | None) -> None:
    folder, draft = _open_folder(target.parent), ""
    try:
        descriptor, draft = _new_file(folder)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            _take_over(descriptor, before)
            os.fsync(descriptor)
            if not draft:
                _give_name(folder, descriptor, target.name)
        if draft:
            os.rename(draft, target.name, src_dir_fd=folder, dst_dir_fd=folder)
        os.fsync(folder)
    finally:
        if draft:
            _unlink(folder, draft)
        os.close(folder)


def _new_file(folder: int) -> tuple[int, str]:
    """Open a new file in `folder`; its name, "" where the file system has files without one."""
    flags = os.O_WRONLY | os.O_CLOEXEC
    try:
        return os.open(".", flags | os.O_TMPFILE, 0o666, dir_fd=folder), ""
    except OSError as error:
        if error.errno not in _NEEDS_A_NAME:
            raise
    draft = f".{secrets.token_hex(8)}.new"  # drawn: another writer of the same file does not meet it
    return os.open(draft, flags | os.O_CREAT | os.O_EXCL, 0o666, dir_fd=folder), draft


def _give_name(folder: int, file: int, name: str) -> None:
    """Name a file that has none, by way of a second name: `linkat` replaces nothing."""
    second = f".{name}.new"  # always the same one, so that the next write removes what a kill left here
    try:
        while True:
            _unlink(folder, second)
            try:
                # Only the `linkat` that a folder's descriptor asks for follows /proc to the file itself.
                os.link(f"/proc/self/fd/{file}", second, src_dir_fd=folder, dst_dir_fd=folder)
            except FileExistsError:  # another writer of the same file was faster
                continue
            with suppress(FileNotFoundError):  # another writer took the second name away
                os.rename(second, name, src_dir_fd=folder, dst_dir_fd=folder)
                return
    finally:
        _unlink(folder, second)


def _unlink(folder: int, name: str) -> None:
    with suppress(FileNotFoundError):
        os.unlink(name, dir_fd=folder)


def _take_over(file: int, before: os.stat_result | None) -> None:
    """Give a new file the owner and the mode of the one before it, the owner as far as this user may."""
    if before is None:
        return
    own = os.fstat(file)
    if (own.st_uid, own.st_gid) != (before.st_uid, before.st_gid):
        with suppress(PermissionError):
            os.fchown(file, before.st_uid, before.st_gid)
    os.fchmod(file, stat.S_IMODE(before.st_mode) & 0o777)


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
    with as_owner(path):
        if not path.is_file():  # a FIFO, or a link to a device, would swallow the values
            path.unlink(missing_ok=True)
    write_atomically(path, json.dumps(values, indent=1))
