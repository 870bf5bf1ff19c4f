"""The fleet as services of this machine: user, units, start and end by systemd. All of it needs root."""

import os
import pwd
import shutil
import stat
import subprocess
from pathlib import Path

from edge.core.errors import RequestError
from edge.formats.atomic_file import write_atomically
from fleet.machine.engines import Engine
from fleet.machine.places import USER, FleetMachine, FleetPlaces
from fleet.machine.units import PREFIX, TARGET, unit_files

UNITS = Path("/etc/systemd/system")


def check_root() -> None:
    """Refuse anybody else before anything is made. Errors: RequestError"""
    if os.geteuid() != 0:
        raise RequestError(
            "this makes services of the machine: call it as root, or try it with --folder DIR --foreground"
        )


def check_program(python: Path) -> None:
    """Refuse a Python that the services' user cannot reach. Errors: RequestError"""
    ways = (python.absolute(), python.resolve())  # a virtual environment's is a link
    for place in (place for way in ways for place in (way, *way.parents)):
        if not place.stat().st_mode & stat.S_IXOTH or place in (Path("/root"), Path("/home")):
            raise RequestError(f"{python}: services cannot reach it; install into /opt/greenhouse/venv")


def make_user(machine: FleetMachine) -> None:
    """Make the user as whom the engines run. Errors: RequestError"""
    if not _is_known(machine.user):
        _call(
            "useradd",
            "--system",
            "--user-group",
            "--home-dir",
            machine.data,
            "--shell",
            "/usr/sbin/nologin",
            machine.user,
        )


def give_files(places: FleetPlaces, machine: FleetMachine) -> None:
    """Let the engines' user read the folder, but for the authority's key and papers, and own the data."""
    user = pwd.getpwnam(machine.user)
    os.chown(places.folder, 0, user.pw_gid)
    places.folder.chmod(0o750)
    for path in places.folder.iterdir():
        if path.is_file():
            is_secret = path == places.authority_key
            os.chown(path, 0, 0 if is_secret else user.pw_gid)
            path.chmod(0o600 if is_secret else 0o640)
    for path in (Path(machine.data), *Path(machine.data).rglob("*")):
        os.chown(path, user.pw_uid, user.pw_gid)
    Path(machine.data).chmod(0o750)


def start(programs: list[Engine], machine: FleetMachine, places: FleetPlaces, units: Path = UNITS) -> None:
    """Have systemd start the engines, now and at each start of the machine. Errors: RequestError"""
    files = unit_files(programs, machine, places.folder)
    for name, content in files.items():
        write_atomically(units / name, content)
    _call("systemctl", "daemon-reload")
    _call("systemctl", "enable", *files)
    _call("systemctl", "restart", TARGET, *(name for name in files if name != TARGET))


def end(machine: FleetMachine, units: Path = UNITS) -> bool:
    """Stop the services and remove their units; return whether there were any. Errors: RequestError"""
    files = sorted(path.name for path in units.glob(f"{PREFIX}*") if path.suffix in (".service", ".target"))
    if not files:
        return False
    _call("systemctl", "disable", "--now", *files)
    for name in files:
        (units / name).unlink()
    _call("systemctl", "daemon-reload")
    return True


def erase(places: FleetPlaces, machine: FleetMachine) -> None:
    """Delete settings, papers, certificates, data and user. Errors: OSError, RequestError"""
    for folder in (Path(machine.data), places.folder):
        if folder.exists():
            shutil.rmtree(folder)
    if machine.user == USER and _is_known(USER):
        _call("userdel", USER)


def _is_known(user: str) -> bool:
    try:
        pwd.getpwnam(user)
    except KeyError:
        return False
    return True


def _call(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RequestError(f"{' '.join(command[:2])} has failed: {done.stderr.strip() or done.returncode}")
