"""app/outlet.py: a full device or a reader that stalls costs lines, never time; also of the whole daemon."""

import io
import json
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from edge.app.outlet import WAITING_MAX, Outlet, standard_output
from edge.core.processes import die_with_parent
from tests.support.broker import wait_for
from tests.support.daemon_process import ROOT, DaemonProcess, run_command
from tests.support.virtual_board import VirtualBoard

pytestmark = pytest.mark.slow
pytest_plugins = ["rig_places"]

FILLED = 200_000  # bytes, more than a pipe holds


def test_what_is_written_comes_out_in_order() -> None:
    text = io.StringIO()
    out = Outlet(text)
    for number in range(100):
        print(number, file=out)
    out.finish()
    assert text.getvalue() == "".join(f"{number}\n" for number in range(100))


def test_a_character_that_the_stream_cannot_encode_is_escaped(tmp_path: Path) -> None:
    with (tmp_path / "log").open("w", encoding="ascii") as file:
        out = Outlet(file)
        out.write("\ud800 \u00e9\n")
        out.finish()
    assert (tmp_path / "log").read_text() == "\\ud800 \\xe9\n"


def test_a_reader_that_stalls_costs_lines_and_no_time_and_is_told_how_many() -> None:
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as pipe:
        out = Outlet(pipe)
        begun = time.monotonic()
        for _ in range(10 * WAITING_MAX):
            out.write("x" * 999 + "\n")
        assert time.monotonic() - begun < 1.0
        assert out.faults() == {"output.behind": "nobody reads"}
        heard = bytearray()
        reader = threading.Thread(
            target=lambda: [heard.extend(data) for data in iter(lambda: os.read(reading, 65536), b"")]
        )
        reader.start()
        wait_for(lambda: out._texts.empty())
        out.write("the last\n")
        wait_for(lambda: not out.faults())
        out.finish()
    reader.join()
    os.close(reading)
    lines = heard.decode().splitlines()
    lost = sum(int(line[1:].split()[0]) for line in lines if " lines were lost here: " in line)
    assert lost + sum(line.startswith("x") for line in lines) == 10 * WAITING_MAX
    assert lines[-1] == "the last"


def test_closing_does_not_wait_for_a_reader_that_stalls() -> None:
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as pipe:
        out = Outlet(pipe)
        out.write("x" * FILLED)
        out.write("x" * FILLED)
        begun = time.monotonic()
        out.finish(0.2)
        assert time.monotonic() - begun < 2.0
        os.close(reading)  # ends the thread


def test_a_full_device_is_a_fault_until_it_takes_a_line_again() -> None:
    with Path("/dev/full").open("w") as device:
        out = Outlet(device)
        out.write("lost\n")
        wait_for(lambda: out.faults() == {"output.behind": "No space left on device"})
        out.finish()


def test_a_line_that_cannot_be_made_is_named_and_the_next_one_comes() -> None:
    text = io.StringIO()
    out = Outlet(text)
    out.write_later(lambda: str(1 / 0))
    out.write_later(lambda: "next\n")
    out.finish()
    assert text.getvalue().splitlines() == [
        "(a line could not be made: ZeroDivisionError('division by zero'))",
        "next",
    ]


def test_prints_of_any_library_go_the_same_way(capfd: pytest.CaptureFixture[str]) -> None:
    with standard_output():
        print("to out")
        print("to error", file=sys.stderr)
        assert isinstance(sys.stdout, Outlet)
    assert not isinstance(sys.stdout, Outlet)
    heard = capfd.readouterr()
    assert (heard.out, heard.err) == ("to out\n", "to error\n")


# the whole daemon


def stop(daemon: DaemonProcess) -> float:
    """Ask for an emergency stop; the time until its answer."""
    begun = time.monotonic()
    assert daemon.ask("emergency_stop")["operation"]["emergency_stop"] is True
    return time.monotonic() - begun


def start(daemon: DaemonProcess, out: Any) -> None:
    """Run with both of its outputs there."""
    daemon.config.with_name("daemon.log").touch()
    daemon.process = subprocess.Popen(
        run_command(daemon.config), stdout=out, stderr=out, cwd=ROOT, preexec_fn=die_with_parent
    )
    wait_for(lambda: daemon.seq() >= 2, "two ticks")


def test_a_full_device_ends_nothing_and_is_told(folder: Path, board: VirtualBoard) -> None:
    daemon = DaemonProcess(folder)
    try:
        with Path("/dev/full").open("w") as device:
            start(daemon, device)
        wait_for(lambda: daemon.has_event("output.behind"))
        daemon.wait_ticks(2)
        assert stop(daemon) < 2.0
        assert daemon.stop() == 0
    finally:
        daemon.kill()


def test_a_pipe_that_nobody_reads_freezes_neither_ticks_nor_stop(folder: Path, board: VirtualBoard) -> None:
    daemon = DaemonProcess(folder)
    reading, writing = os.pipe()
    try:
        os.set_blocking(writing, False)
        with pytest.raises(BlockingIOError):  # so full that not one line goes in
            while True:
                os.write(writing, b"x" * 4096)
        os.set_blocking(writing, True)
        start(daemon, writing)
        os.close(writing)
        daemon.wait_ticks(3)
        assert stop(daemon) < 2.0
        begun = time.monotonic()
        assert daemon.stop() == 0
        assert time.monotonic() - begun < 10.0
    finally:
        os.close(reading)
        daemon.kill()


def test_a_journal_that_stalls_for_a_while_is_told_afterwards(folder: Path, board: VirtualBoard) -> None:
    """Standard output is a socket under systemd."""
    daemon = DaemonProcess(folder)
    ours, theirs = socket.socketpair()
    try:
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
        start(daemon, theirs)
        theirs.close()
        daemon.wait_ticks(3)
        assert json.loads(json.dumps(daemon.ask("status")))["ok"]
        ours.settimeout(20.0)
        heard = b""
        while heard.count(b" tick ") < 5:
            heard += ours.recv(65536)
        assert daemon.stop() == 0
    finally:
        ours.close()
        daemon.kill()


def test_a_demo_whose_reader_has_left_ends(folder: Path) -> None:
    demo = subprocess.Popen(
        [sys.executable, "-m", "edge", "demo", "--speed", "600"], stdout=subprocess.PIPE, cwd=ROOT
    )
    assert demo.stdout is not None
    demo.stdout.readline()
    demo.stdout.close()
    assert demo.wait(30) == 0
