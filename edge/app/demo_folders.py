"""Folders of this user's demos: where the running ones listen, and what the last one recorded.

One directory that only the user can write holds them, or links to them, each named by the demo's process.
A folder stays until the next demo starts, so that a demo that has ended can still be plotted.
"""

import contextlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from edge.core.errors import RequestError
from edge.sockets.client import listens

SOCKET = "control.sock"
HISTORY = "history.db"
FOLDER_MAX = 80  # bytes; with the names of the sockets in it below the 108 of sun_path


def demos_directory() -> Path:
    """Return the folder of this user's demos."""
    return Path(tempfile.gettempdir()) / f"greenhouse-demos-{os.getuid()}"


def make_demo_folder(out: Path | None) -> Path:
    """Return the new folder of this process's demo; `out` where the user named one.

    Errors : RequestError that names the option or the directory
    """
    home = demos_directory()
    with contextlib.suppress(OSError):
        home.mkdir(mode=0o700)
    if not _is_ours(home):
        raise RequestError(f"{home}: cannot be made, or is not of this user alone")
    _remove_ended(home)
    entry = home / str(os.getpid())
    _remove(entry)
    if out is None:
        entry.mkdir(mode=0o700)
        return entry
    # A Unix socket's path has 108 bytes at most: the error would come late, from bind.
    if len(os.fsencode(out)) > FOLDER_MAX:
        raise RequestError(f"--out: {out}: longer than {FOLDER_MAX} bytes, too long for a socket in it")
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise RequestError(f"--out: {out}: {error.strerror or error}") from None
    entry.symlink_to(out.resolve())
    return out


def running_demos() -> list[Path]:
    """Return the folders of the demos that listen, newest first."""
    return [folder for folder in _folders() if listens(folder / SOCKET)]


def last_history() -> Path | None:
    """Return the database of the demo that was started last, None where there is none."""
    return next((folder / HISTORY for folder in _folders() if (folder / HISTORY).exists()), None)


def _folders() -> Iterator[Path]:
    home = demos_directory()
    if not _is_ours(home):
        return
    entries = sorted(home.iterdir(), key=lambda entry: entry.lstat().st_mtime, reverse=True)
    yield from (entry.resolve() for entry in entries)


def _is_ours(home: Path) -> bool:
    """Nobody else can have put a socket there, for us to send orders to."""
    try:
        found = home.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077


def _remove_ended(home: Path) -> None:
    for entry in home.iterdir():
        if not (entry.name.isdigit() and Path("/proc", entry.name).exists()):
            _remove(entry)


def _remove(entry: Path) -> None:
    """Remove a demo's own folder, but only the link to one that the user named."""
    if entry.is_symlink() or entry.is_file():
        entry.unlink()
    else:
        with contextlib.suppress(FileNotFoundError):
            shutil.rmtree(entry)
