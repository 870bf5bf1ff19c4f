"""Daemons of this machine: the run folder has an entry with the name, socket and stop folder of each."""

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from edge.app.demo_folders import SOCKET, running_demos
from edge.config.settings import ControlSocketSettings, Settings
from edge.core.errors import DataError
from edge.formats.atomic_file import write_atomically
from edge.formats.reader import read_json

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


def register(settings: Settings) -> Path | None:
    """Write the entry of a daemon that listens; None where no run folder is. Errors: OSError"""
    socket, stops = Path(settings.control_socket.path).absolute(), settings.stop_folder.absolute()
    entry = _run_folder() / f"{sha256(bytes(socket)).hexdigest()[:16]}.rig"
    if not entry.parent.is_dir():
        return None
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
