"""Daemons of this machine: the run folder has an entry with the name, socket and stop folder of each.

Demos have folders instead. One directory that only the user can write holds them, or links to them, each
named by the demo's process. A folder stays until the next demo starts, so that a demo that has ended can
still be plotted.
"""

import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from edge.config.settings import ControlSocketSettings, Settings
from edge.core.errors import DataError, RequestError
from edge.formats.atomic_file import write_atomically
from edge.formats.reader import read_json
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
    with suppress(OSError):
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
        with suppress(FileNotFoundError):
            shutil.rmtree(entry)


DEMO = "demo"  # name of every demo's rig, for which `greenhouse demo --mqtt` publishes


@dataclass(frozen=True, slots=True)
class RunningRig:
    """A daemon's address; "" for what is not known.

    name : `mqtt.rig`; stops : folder of a stop that waits for the daemon
    entry : file or folder that named the other two, and whose owner could have named any
    """

    name: str
    socket: str
    stops: str = ""
    entry: str = ""
    is_demo: bool = False


def register(settings: Settings) -> Path:
    """Write the entry of a daemon that listens. Errors: OSError for a folder that this user may not write"""
    socket, stops = Path(settings.control_socket.path).absolute(), settings.stop_folder.absolute()
    entry = _run_folder() / f"{sha256(bytes(socket)).hexdigest()[:16]}.rig"
    if not entry.parent.is_dir():
        entry.parent.mkdir(exist_ok=True)
        entry.parent.chmod(0o755)  # whoever stops all rigs has to find this one
    write_atomically(
        entry, json.dumps({"name": settings.mqtt.rig, "socket": str(socket), "stops": str(stops)})
    )
    return entry


def known_rigs() -> Iterator[RunningRig]:
    """Yield each rig that has registered, also where a kill has left its entry; then the running demos."""
    folder = _run_folder()
    for entry in sorted(folder.glob("*.rig")) if folder.is_dir() else ():
        with suppress(DataError):
            yield replace(read_json(RunningRig, entry), entry=str(entry), is_demo=False)
    for demo in running_demos():
        yield RunningRig(DEMO, str(demo / SOCKET), str(demo / "stops"), str(demo), is_demo=True)


def _run_folder() -> Path:
    return Path(ControlSocketSettings().path).parent
