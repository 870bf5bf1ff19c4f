"""Passwords and keys: from a file of restricted access or from a systemd credential, never shown."""

import os
import stat
from dataclasses import dataclass, field
from pathlib import Path

from edge.core.errors import ConfigError
from edge.formats.input_file import open_file

SIZE_MAX = 4096  # [bytes]
FORBIDDEN_MODE = 0o037  # a secret file: group may read, others nothing, nobody but the owner writes


@dataclass(frozen=True, slots=True)
class Secret:
    """A value that no log and no traceback prints by accident."""

    value: str = field(repr=False)


def secret_path(name: str, setting: str) -> Path:
    """Return the path of a secret; a bare name is a systemd credential (LoadCredential= in the unit).

    setting : name of the key, for messages, e.g. "mqtt.password_file"
    Errors : ConfigError when it is missing, not a file, or readable by others
    """
    path = Path(name)
    if "/" not in name:
        directory = os.environ.get("CREDENTIALS_DIRECTORY")
        if not directory:
            raise ConfigError(
                f"{setting}: {name!r} is the name of a systemd credential, but $CREDENTIALS_DIRECTORY is not "
                f"set; outside systemd give a path"
            )
        path = Path(directory) / name
    _check_access(path, setting)
    return path


def read_secret(name: str, setting: str) -> Secret:
    """Read a secret without the newline at its end. Errors: ConfigError, which never holds the text"""
    path = secret_path(name, setting)
    try:
        with open_file(path) as file:
            raw = file.read(SIZE_MAX + 1)
        text = raw.decode().removesuffix("\n").removesuffix("\r")
    except OSError as error:
        raise ConfigError(f"{setting}: {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{setting}: {path}: is not UTF-8 text") from None
    if not text or len(raw) > SIZE_MAX:
        raise ConfigError(f"{setting}: {path}: is {'empty' if not text else f'over {SIZE_MAX} bytes'}")
    return Secret(text)


def _check_access(path: Path, setting: str) -> None:
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise ConfigError(f"{setting}: {path}: {error.strerror}") from None
    if not stat.S_ISREG(mode):
        raise ConfigError(f"{setting}: {path}: is not a file")
    if mode & FORBIDDEN_MODE:
        raise ConfigError(
            f"{setting}: {path}: mode {stat.S_IMODE(mode):04o} lets others in; make it 0600 or 0640"
        )
