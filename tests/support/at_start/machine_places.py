"""Keep the tests and their processes away from an installation on this machine: for them it does not exist.

To ask whether such a place exists is answered with no. To open, list or change one, or to connect to it,
is an error, and a line in the file that the variable OFFENCES names: `tests/conftest.py` fails the test then.
"""

import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

OFFENCES = "GREENHOUSE_TESTS_OFFENCES"
RUN = "/run/greenhouse"
PLACES = (
    "/etc/greenhouse",  # and greenhouse-fleet, as below
    "/etc/mosquitto/conf.d/greenhouse",
    "/etc/mosquitto/greenhouse",
    "/etc/systemd/system/greenhouse",
    "/var/lib/greenhouse",
    RUN,
    "/run/systemd/system",
    f"/tmp/greenhouse-demos-{os.getuid()}",  # this person's own demos
    "/dev/greenhouse",
    "/dev/serial",
)
BOARD = os.environ.get("GREENHOUSE_PORT", "")  # for tests with the marker `hardware`
HIDDEN = tuple(place for place in PLACES if not BOARD.startswith(place))
EVENTS = frozenset(
    (
        *("open", "socket.bind", "socket.connect", "sqlite3.connect"),
        *("os.chmod", "os.chown", "os.link", "os.listdir", "os.mkdir", "os.remove", "os.rename", "os.rmdir"),
        *("os.scandir", "os.symlink", "os.truncate", "os.utime"),
    )
)


def is_hidden(path: Any) -> bool:
    """Return whether it is a path of a place that tests are kept from."""
    if not isinstance(path, str | bytes | os.PathLike):
        return False
    text = os.fsdecode(path)
    if text.startswith("file:"):  # as sqlite3 may be given it
        text = "/" + text.removeprefix("file:").lstrip("/")
    return text.startswith(HIDDEN)


def _refuse(event: str, values: tuple[Any, ...]) -> None:
    """Hook of `sys.addaudithook`."""
    if event not in EVENTS:
        return
    if event == "os.symlink":
        values = values[1:]  # a link may name anything
    for path in filter(is_hidden, values):
        if event == "os.mkdir" and os.fsdecode(path) == RUN:  # every daemon tries, and runs without it
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), RUN)
        if offences := os.environ.get(OFFENCES):
            with Path(offences).open("a") as file:
                print(f"{event} {os.fsdecode(path)}", file=file)
        raise FileNotFoundError(errno.ENOENT, "a test reached for a place of this machine", os.fsdecode(path))


def _without(look: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap os.stat or os.lstat, which raise no audit event."""

    def see(path: Any, *more: Any, **named: Any) -> Any:
        if is_hidden(path):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
        return look(path, *more, **named)

    for able in (os.supports_dir_fd, os.supports_fd, os.supports_follow_symlinks):
        if look in able:
            able.add(see)
    return see


def _access(path: Any, *more: Any, _access: Callable[..., bool] = os.access, **named: Any) -> bool:
    return not is_hidden(path) and _access(path, *more, **named)


sys.addaudithook(_refuse)
os.stat, os.lstat, os.access = _without(os.stat), _without(os.lstat), _access
