"""A Unix socket that one process listens at; its file's permissions are the access control."""

import contextlib
import os
import socket
import stat
from pathlib import Path

from edge.core.errors import ConfigError
from edge.sockets.client import listens

BACKLOG = 128
MODE = 0o660


def listen(path: Path, key: str) -> tuple[socket.socket, int]:
    """Listen at `path` with a socket that never blocks; return it and its inode. A stale file is replaced.

    key : of the configuration, for errors
    Errors : ConfigError when somebody listens there already, or the place can't hold a socket
    """
    _refuse_live(path, key)
    # The name appears by a rename, with the final permissions on it: at no moment can others get in.
    fresh = path.with_name(f"{path.name}.{os.getpid()}")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        with contextlib.suppress(FileNotFoundError):
            fresh.unlink()
        listener.bind(str(fresh))
        fresh.chmod(MODE)
        inode = fresh.stat().st_ino
        listener.listen(BACKLOG)
        listener.setblocking(False)
        fresh.rename(path)
    except OSError as error:
        listener.close()
        fresh.unlink(missing_ok=True)
        raise ConfigError(f"{key}: {path}: {error.strerror or error}") from None
    return listener, inode


def _refuse_live(path: Path, key: str) -> None:
    try:
        mode = path.lstat().st_mode
    except OSError:
        return
    if not stat.S_ISSOCK(mode):
        raise ConfigError(f"{key}: {path}: exists and is not a socket")
    if listens(path):
        raise ConfigError(f"{key}: {path}: another daemon listens there")
