"""Rights for files in a folder that another user can change.

A command that runs as root must not follow a link that the daemon's or the page's user has planted. So it
acts with the rights of the first user on the way to a file who could have planted one. What that user may not
read or write, the command can't either.
"""

import errno
import os
import sqlite3
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

COMPANIONS = ("-wal", "-shm", "-journal")  # of a database
LINKS_MAX = 40  # as the kernel
_acts = threading.local()


@contextmanager
def as_owner(path: str | Path) -> Iterator[bool]:
    """Act with the rights of whoever can change what `path` leads to; yield whether these are new rights.

    Nothing changes unless root runs this. The rights are this thread's, and for files only; root's further
    groups are given up for good.

    Errors : PermissionError for a folder of root's on the way that others can write to
    """
    owner = None if os.geteuid() or getattr(_acts, "for_other", False) else _stranger(path)
    if owner is None:
        yield False
        return
    (user, group), calls = owner, _calls()
    os.setgroups([])
    _acts.for_other = True
    try:
        calls.setfsgid(group)
        calls.setfsuid(user)
        yield True
    finally:
        calls.setfsuid(0)
        calls.setfsgid(0)
        _acts.for_other = False


@cache
def _calls() -> Any:
    import ctypes  # late: the daemon never runs as root

    return ctypes.CDLL(None)


def open_database(path: str | Path, how: str = "", **options: Any) -> sqlite3.Connection:
    """Open an SQLite file, and the log next to it, `as_owner`. Errors: sqlite3.Error

    how : parameters of SQLite's URI, such as mode=ro
    options : of `sqlite3.connect`
    """
    place = f"{Path(path).absolute().as_uri()}?{how}" if how else str(path)
    try:
        with as_owner(path) as is_other:
            for file in (Path(f"{path}{ending}") for ending in ("", *COMPANIONS)):
                if file.exists() and not file.is_file():  # SQLite would wait for a FIFO without end
                    raise sqlite3.OperationalError(f"{file} is not a regular file")
            connection: sqlite3.Connection = sqlite3.connect(place, uri=bool(how), **options)
            if is_other:  # else the log is opened later, with root's rights
                connection.execute("PRAGMA schema_version")
    except OSError as error:  # of a folder on the way, where callers expect SQLite's errors
        raise sqlite3.OperationalError(f"{error.strerror}: {error.filename}") from error
    return connection


def become_owner(path: str | Path) -> None:
    """Give up root for good, as `as_owner`: for a process that works in one folder only."""
    owner = None if os.geteuid() else _stranger(path)
    if owner is None:
        return
    import pwd

    user, group = owner
    try:
        os.initgroups(pwd.getpwuid(user).pw_name, group)  # serial ports belong to a group
    except KeyError:
        os.setgroups([])
    os.setresgid(group, group, group)
    os.setresuid(user, user, user)


def _stranger(path: str | Path) -> tuple[int, int] | None:
    """Return user and group of the first folder or link on the way to `path` that is not root's."""
    place, names, links = Path("/"), _steps(Path(path).absolute()), 0
    while names:
        try:
            folder = place.stat()
        except (FileNotFoundError, NotADirectoryError):
            return None  # all above it is root's, who is about to make it
        if folder.st_uid:
            return folder.st_uid, folder.st_gid
        others = stat.S_IWOTH | (stat.S_IWGRP if folder.st_gid else 0)
        if folder.st_mode & others and not folder.st_mode & stat.S_ISVTX:
            text = "others than root can write to this folder: chmod go-w"
            raise PermissionError(errno.EPERM, text, str(place))
        name = names.pop()
        entry = place.parent if name == ".." else place / name
        try:
            target, link = entry.readlink(), entry.lstat()
        except OSError:  # no link
            place = entry
            continue
        if link.st_uid:  # in a folder such as /tmp
            return link.st_uid, link.st_gid
        links += 1
        if links > LINKS_MAX:
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
        place = Path("/") if target.is_absolute() else place
        names += _steps(target)
    return None


def _steps(path: Path) -> list[str]:
    """Return the names of a path, the first one last."""
    return [name for name in reversed(path.parts) if name != "/"]
