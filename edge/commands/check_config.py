"""`greenhouse check-config FILE`: check a configuration on this machine: files, folders, sockets, ports.

An error would end the daemon or leave a part of it without work. A warning may be right at another moment or
for another user: a board that is not plugged in, a credential that only systemd hands over.
"""

import argparse
import errno
import getpass
import os
import stat
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from edge.app.active_models import configured_model
from edge.app.box import bounds_of
from edge.config import loading as config
from edge.config.alarm_settings import AlarmSettings
from edge.config.secrets import read_secret
from edge.config.settings import BundleSettings, ControlSocketSettings, MqttSettings, Settings
from edge.core.errors import ConfigError, DataError, GreenhouseError
from edge.formats.atomic_file import read_document
from edge.formats.input_file import open_file, read_file
from edge.state.store import LIMITS
from edge.tick.reference import make_reference

SOCKET_PATH_MAX = 107  # bytes of a Unix socket's address, unix(7)
FRESH_NAME = ".4194304"  # `edge.sockets.unix_socket.listen` binds to the path with its process id first
DATABASE = b"SQLite format 3\0"  # how every database begins, sqlite.org/fileformat.html
DENIED = os.strerror(errno.EACCES)


@dataclass(frozen=True, slots=True)
class ConfigProblem:
    """A line of text that begins with the key."""

    text: str
    is_error: bool = True


def problems(settings: Settings) -> Iterator[ConfigProblem]:
    """Everything that is wrong with what `settings` name on this machine."""
    yield from _problems_of(lambda: configured_model(settings.control))
    yield from _problems_of(lambda: make_reference(settings.reference))
    yield from _problems_of(lambda: bounds_of(settings.box))
    yield from _heater(settings)
    yield from _port(settings.board.port)
    yield from _data_file("state_file", Path(settings.state_file), _state_problem)
    yield from _data_file("history.path", Path(settings.history.path), _history_problem)
    yield from _socket("control_socket.path", settings.control_socket.path)
    if settings.external.socket:
        yield from _socket("external.socket", settings.external.socket)
    yield from _shared_paths(settings)
    yield from _bundle(settings.bundle)
    if settings.drift.diagnose != "never":
        yield from _folder("drift.reports", settings.drift.reports)
    if settings.mqtt.enabled:
        yield from _mqtt(settings.mqtt)
    if settings.llm.url:
        yield from _llm(settings)
    yield from _alarms(settings.alarms)


def _problems_of(check: Callable[[], object]) -> Iterator[ConfigProblem]:
    try:
        check()
    except GreenhouseError as error:
        yield ConfigProblem(str(error), DENIED not in str(error))


def _heater(settings: Settings) -> Iterator[ConfigProblem]:
    """Warn of a heater of unknown power; refuse one where older software ran: then it stops heating."""
    if not (settings.box.twin or settings.box.heater_w) and settings.safety.heater_max_duty > 0.0:
        text = "box.heater_w: the heater's power is not known: this rig does not heat until it is named [W]"
        # Software that has limits on file does not heat with such settings: nothing changes then.
        heated = _mode(settings.state_file) is not None and _mode(str(LIMITS.place(settings))) is None
        yield ConfigProblem(text, heated)


def _secret(name: str, key: str) -> Iterator[ConfigProblem]:
    if name and "/" not in name and not os.environ.get("CREDENTIALS_DIRECTORY"):
        yield ConfigProblem(f"{key}: {name!r} is a systemd credential: only the service can read it", False)
    elif name:
        yield from _problems_of(lambda: read_secret(name, key))


def _port(path: str) -> Iterator[ConfigProblem]:
    mode = _mode(path)
    if not path:
        yield ConfigProblem("board.port: is empty")
    elif mode is None:
        yield ConfigProblem(f"board.port: {path}: is not there; the daemon waits for it", False)
    elif not stat.S_ISCHR(mode):
        yield ConfigProblem(f"board.port: {path}: is not a serial port")


def _data_file(key: str, path: Path, check: Callable[[Path], str]) -> Iterator[ConfigProblem]:
    """Check a file that the daemon creates where it is missing."""
    mode = _mode(path)
    if mode is None:
        yield from _place(key, path)
    elif not stat.S_ISREG(mode):
        yield ConfigProblem(f"{key}: {path}: is {'a folder' if stat.S_ISDIR(mode) else 'not a regular file'}")
    elif not os.access(path, os.R_OK | os.W_OK):
        yield ConfigProblem(f"{key}: {path}: {DENIED} for the user {_user()}", False)
    elif problem := check(path):
        yield ConfigProblem(f"{key}: {problem}")


def _state_problem(path: Path) -> str:
    try:
        read_document(path)
    except DataError as error:
        return str(error)
    return ""


def _history_problem(path: Path) -> str:
    try:
        with open_file(path) as file:
            begin = file.read(len(DATABASE))
    except OSError as error:
        return f"{path}: {error.strerror}"
    return "" if begin in (b"", DATABASE) else f"{path}: is not an SQLite database"


def _socket(key: str, path: str) -> Iterator[ConfigProblem]:
    mode = _mode(path)
    if not path:
        yield ConfigProblem(f"{key}: is empty")
    elif len(os.fsencode(path + FRESH_NAME)) > SOCKET_PATH_MAX:
        yield ConfigProblem(f"{key}: {path}: is too long for a Unix socket")
    elif mode is not None and not stat.S_ISSOCK(mode):
        yield ConfigProblem(f"{key}: {path}: exists and is not a socket")
    elif mode is None and not Path(path).parent.exists():
        # The service's RuntimeDirectory= makes this one at its start; nobody makes another.
        if Path(path).parent != Path(ControlSocketSettings().path).parent:
            yield ConfigProblem(f"{key}: {path}: the folder {Path(path).parent} is missing")
    elif mode is None:
        yield from _place(key, Path(path))


def _shared_paths(settings: Settings) -> Iterator[ConfigProblem]:
    """One path for two purposes."""
    named = {
        "state_file": settings.state_file,
        "history.path": settings.history.path,
        "control_socket.path": settings.control_socket.path,
        "external.socket": settings.external.socket,
        "board.port": settings.board.port,
    }
    seen: dict[str, str] = {}
    for key, path in named.items():
        real = os.path.realpath(path) if path else ""
        if real and real in seen:
            yield ConfigProblem(f"{key}: {path}: is {seen[real]} too")
        seen[real] = key


def _bundle(bundle: BundleSettings) -> Iterator[ConfigProblem]:
    if not bundle.path:
        return
    yield from _folder("bundle.path", bundle.path)
    if (mode := _mode(bundle.trusted_keys)) is not None and not stat.S_ISDIR(mode):
        yield ConfigProblem(f"bundle.trusted_keys: {bundle.trusted_keys}: is not a folder")
    if bundle.signing_key:
        yield from _readable("bundle.signing_key", bundle.signing_key)


def _mqtt(mqtt: MqttSettings) -> Iterator[ConfigProblem]:
    from edge.mqtt.connection import tls_context  # late: paho

    yield from _secret(mqtt.password_file, "mqtt.password_file")
    files = {"mqtt.ca": mqtt.ca, "mqtt.client_cert": mqtt.client_cert}
    missing = [problem for key, path in files.items() if path for problem in _readable(key, path)]
    yield from missing
    yield from _secret(mqtt.client_key, "mqtt.client_key")
    if mqtt.tls and not missing and (not mqtt.client_key or _mode(mqtt.client_key) is not None):
        yield from _problems_of(lambda: tls_context(mqtt))


def _llm(settings: Settings) -> Iterator[ConfigProblem]:
    from edge.assistant.llm.language_model import open_line

    yield from _secret(settings.llm.key_file, "llm.key_file")
    yield from _problems_of(lambda: open_line(settings.llm))


def _alarms(alarms: AlarmSettings) -> Iterator[ConfigProblem]:
    for key, name in alarms.secret_files():
        yield from _secret(name, key)
    for section in ("ntfy", "mail", "webhook", "life_sign"):
        if path := getattr(alarms, section).ca:
            yield from _readable(f"alarms.{section}.ca", path)


def _readable(key: str, path: str) -> Iterator[ConfigProblem]:
    try:
        read_file(Path(path))
    except OSError as error:
        yield ConfigProblem(f"{key}: {path}: {error.strerror}", error.errno != errno.EACCES)


def _folder(key: str, path: str) -> Iterator[ConfigProblem]:
    mode = _mode(path)
    if mode is None:
        yield from _place(key, Path(path))
    elif not stat.S_ISDIR(mode):
        yield ConfigProblem(f"{key}: {path}: is not a folder")


def _place(key: str, path: Path) -> Iterator[ConfigProblem]:
    """Can `path`, which is missing, be made?"""
    above = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    if not above.is_dir():
        yield ConfigProblem(f"{key}: {path}: {above} is not a folder")
    elif not os.access(above, os.W_OK | os.X_OK):
        yield ConfigProblem(f"{key}: {path}: the user {_user()} cannot write into {above}", False)


def _mode(path: str | Path) -> int | None:
    """Kind and permissions, None where nothing is there or nothing can be seen."""
    try:
        return Path(path).stat().st_mode
    except OSError:
        return None


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user id without a name
        return str(os.geteuid())


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("file", help="configuration file, as /etc/greenhouse/edge.yaml")


def run(arguments: argparse.Namespace) -> int:
    """0 when the daemon would start with it and every part would work. Errors: ConfigError with all problems.

    What may be right later or for another user is a warning on standard error.
    """
    settings = config.load(arguments.file)
    found = list(problems(settings))
    for problem in found:
        if not problem.is_error:
            print(f"warning: {arguments.file}: {problem.text}", file=sys.stderr)
    if errors := [problem.text for problem in found if problem.is_error]:
        raise ConfigError("\n".join(f"{arguments.file}: {text}" for text in errors))
    print(f"{arguments.file} is good (settings {config.config_hash(settings)})")
    return 0
