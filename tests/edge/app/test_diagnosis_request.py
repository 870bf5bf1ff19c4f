"""app/diagnosis_request.py: the daemon asks by a file, a unit of its own runs the command and answers."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from test_nightly_diagnosis import Night

from bench.support.broker import wait_for
from edge.app import nightly_diagnosis
from edge.app.nightly_diagnosis import ANSWER, LATE, REQUEST, NoUnit, ask, serve

HERE = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def short_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nightly_diagnosis, "LOOK_S", 0.02)
    monkeypatch.setattr(nightly_diagnosis, "START_MAX_S", 5.0)


@contextmanager
def path_unit(folder: Path, script: str) -> Iterator[None]:
    """Do as systemd does: start the service once the request is there."""
    over = threading.Event()

    def watch() -> None:
        while not over.is_set():
            if (folder / REQUEST).exists():
                serve(folder, (sys.executable, "-c", script))
            over.wait(0.02)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    yield
    over.set()
    thread.join(10.0)


def asked(folder: Path, script: str, patience_s: float = 20.0) -> int | str:
    with path_unit(folder / "requests", script):
        return ask(folder / "requests", ["twin", "diagnose"], folder / "log.txt", patience_s, lambda: False)


@pytest.mark.parametrize(
    ("script", "code"),
    [
        ("import sys; print(sys.argv[1:])", 0),
        ("import sys; sys.exit(3)", 3),
        ("import os; os.kill(os.getpid(), 9)", -9),
    ],
)
def test_the_answer_is_how_the_command_ended(tmp_path: Path, script: str, code: int) -> None:
    assert asked(tmp_path, script) == code
    assert not (tmp_path / "requests" / REQUEST).exists()
    if code == 0:
        assert (tmp_path / "log.txt").read_text() == "['twin', 'diagnose']\n"


def test_a_command_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    began = time.monotonic()
    assert asked(tmp_path, "import time; time.sleep(60)", patience_s=0.3) == LATE
    assert time.monotonic() - began < 20.0


def test_an_old_answer_is_not_taken_for_a_new_one(tmp_path: Path) -> None:
    (tmp_path / "requests").mkdir()
    (tmp_path / "requests" / ANSWER).write_text('{"code": 0}')
    assert asked(tmp_path, "import sys; sys.exit(4)") == 4


def test_without_the_unit_the_failure_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nightly_diagnosis, "START_MAX_S", 0.1)
    with pytest.raises(NoUnit, match=r"greenhouse-diagnosis\.path is not active"):
        ask(tmp_path / "requests", ["twin"], tmp_path / "log.txt", 1.0, lambda: False)
    assert not (tmp_path / "requests").exists()  # no request is left for a unit that is enabled later


@pytest.mark.parametrize("way", ["close", "kill"])
def test_the_command_ends_with_the_daemon(tmp_path: Path, way: str) -> None:
    """The daemon removes the folder as it ends; where it was killed systemd does, its RuntimeDirectory=."""
    folder, pid_file = tmp_path / "requests", tmp_path / "pid"
    script = f"import os, time; open({str(pid_file)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    over = threading.Event()

    def daemon() -> None:
        with pytest.raises(NoUnit):
            ask(folder, ["twin"], tmp_path / "log.txt", 60.0, over.is_set)

    thread = threading.Thread(target=daemon)
    with path_unit(folder, script):
        thread.start()
        wait_for(lambda: pid_file.exists() and pid_file.read_text())
        if way == "kill":
            nightly_diagnosis.shutil.rmtree(folder)
        over.set()
        thread.join(10.0)
        wait_for(lambda: not is_alive(int(pid_file.read_text())))


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_the_unit_is_started_as_a_program(tmp_path: Path) -> None:
    """As deploy/greenhouse-diagnosis.service does; the command here is one that is refused."""
    folder = tmp_path / "requests"
    started: list[subprocess.Popen[bytes]] = []

    def start_unit() -> bool:
        if not started and (folder / REQUEST).exists():
            command = [sys.executable, "-m", "edge.app.nightly_diagnosis", str(folder)]
            started.append(subprocess.Popen(command, cwd=HERE))
        return False

    code = ask(folder, ["twin", "nonsense"], tmp_path / "log.txt", 60.0, start_unit)
    assert code == 2
    assert "nonsense" in (tmp_path / "log.txt").read_text()
    assert started[0].wait(20.0) == 0


def test_a_night_is_asked_of_the_unit_and_a_kill_by_its_limit_is_told(tmp_path: Path) -> None:
    requests = tmp_path / "requests"
    with (
        path_unit(requests, "import os; os.kill(os.getpid(), 9)"),
        Night(tmp_path, requests=requests) as night,
    ):
        night.strike_three()
        assert "ended with -9: it needed more memory than it may have" in night.told("diagnosis.failed")
    assert night.calls == []
