"""Floods of the control socket against the whole daemon: a stop is not held up, ticks go on."""

import contextlib
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.daemon_process import DaemonProcess
from tests.support.virtual_board import VirtualBoard

pytestmark = pytest.mark.slow
pytest_plugins = ["rig_places"]

# Behind a flood it would wait for minutes; how long it does wait: `python -m bench attack`.
HELD_UP_S = 10.0
FLOOD = """
import socket, sys, threading, time
path, line = sys.argv[1], sys.argv[2].encode() + b"\\n"
def pour():
    while True:
        try:
            with socket.socket(socket.AF_UNIX) as guest:
                guest.connect(path)
                threading.Thread(target=drink, args=(guest,), daemon=True).start()
                while True:
                    guest.sendall(line * 50)
        except OSError:
            time.sleep(0.01)
def drink(guest):
    try:
        while guest.recv(65536): pass
    except OSError: pass
for _ in range(40):
    threading.Thread(target=pour, daemon=True).start()
time.sleep(60)
"""


def test_a_stop_in_a_flood_of_other_requests_is_not_held_up(folder: Path, board: VirtualBoard) -> None:
    with DaemonProcess(folder) as daemon:
        for request in (
            {"do": "status"},
            {"do": "set_manual", "heater_duty": 0.1},
            {"do": "why"},
            {"do": "ask"},
        ):
            with flooded(daemon, request):
                time.sleep(0.5)
                for what, values in (("emergency_stop", {}), ("maintenance", {"minutes": 5})):
                    begun = time.monotonic()
                    answer = daemon.ask(what, **values)
                    assert time.monotonic() - begun < HELD_UP_S, request
                    assert answer["ok"], answer
            assert daemon.ask("status")["operation"]["emergency_stop"]
            assert daemon.ask("release_emergency_stop")["ok"]
        daemon.wait_ticks(1)


@contextlib.contextmanager
def flooded(daemon: DaemonProcess, request: dict[str, object]) -> Iterator[None]:
    flood = subprocess.Popen([sys.executable, "-c", FLOOD, str(daemon.socket), json.dumps(request)])
    try:
        yield
    finally:
        flood.kill()
        flood.wait()


def test_clients_that_send_half_a_line_or_never_read_do_not_hold_up_a_stop(
    folder: Path, board: VirtualBoard
) -> None:
    with DaemonProcess(folder) as daemon, contextlib.ExitStack() as stack:
        for number in range(200):
            guest = stack.enter_context(socket.socket(socket.AF_UNIX))
            guest.connect(str(daemon.socket))
            guest.settimeout(5.0)
            with contextlib.suppress(OSError):  # its place was needed
                guest.sendall(b'{"do": ' if number % 2 else b'{"do": "status"}\n' * 20)
        begun = time.monotonic()
        assert daemon.ask("emergency_stop")["ok"]
        assert time.monotonic() - begun < HELD_UP_S
