"""No test depends on an installation on this machine, on its person's demos, or on how the run began."""

import ast
import os
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import machine_places
import pytest

ROOT = Path(__file__).parent.parent
PLACES = ("/etc/greenhouse/edge.yaml", "/var/lib/greenhouse-page/page.db", "/run/greenhouse/control.sock")
WAYS = {
    "read": "Path(place).read_text()",
    "write": "Path(place).write_text('')",
    "replace": "Path('any').replace(place)",
    "list": "list(Path(place).iterdir())",
    "make": "Path(place).mkdir(parents=True)",
    "database": "sqlite3.connect(f'file://{place}?mode=ro', uri=True)",
    "socket": "socket.socket(socket.AF_UNIX).connect(place)",
}
ELSEWHERE = {  # nothing of an installation: names in a pattern, of a program or of what no test may be given
    "/dev/tty(ACM|USB)\\d+",
    "/dev/ptmx",
    "/dev/pts/",
    "/etc/machine-id",  # of any machine
    "/etc/systemd/system",  # greenhouse* below it is hidden
    "/opt/greenhouse/venv/bin/python",
    "/usr/sbin:/usr/local/sbin:/sbin",
    "/usr/sbin/nologin",
}


@pytest.mark.parametrize("place", PLACES)
def test_an_installation_is_not_there_for_a_test(place: str) -> None:
    assert not Path(place).exists() and not os.path.lexists(place) and not os.access(place, os.R_OK)


@pytest.mark.parametrize("way", WAYS)
def test_a_process_of_a_test_that_reaches_for_an_installation_is_refused_and_told(
    offences: Path, way: str
) -> None:
    for place in PLACES:
        code = f"import socket, sqlite3\nfrom pathlib import Path\nplace = {place!r}\n{WAYS[way]}"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert "a test reached for a place of this machine" in done.stderr
        assert str(Path(place).parent) in offences.read_text()
        offences.unlink()


def test_a_test_that_reaches_for_an_installation_is_refused_and_told(offences: Path) -> None:
    with pytest.raises(FileNotFoundError, match="a place of this machine"):
        sqlite3.connect(PLACES[1])
    assert offences.read_text() == f"sqlite3.connect {PLACES[1]}\n"
    offences.unlink()


def test_every_place_that_the_software_uses_by_itself_is_kept_from_the_tests() -> None:
    named = {
        node.value
        for part in ("edge", "fleet", "firmware_protocol")
        for path in (ROOT / part).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and node.value.startswith(("/dev/", "/etc/", "/opt/", "/run/", "/srv/", "/usr/", "/var/", "~/"))
    }
    assert {place for place in named if not machine_places.is_hidden(place)} == ELSEWHERE


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_process_of_a_test_does_not_ignore_what_the_run_ignores(number: signal.Signals) -> None:
    code = f"import signal; print(signal.getsignal({int(number)}) == signal.SIG_IGN)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
