"""The daemon as a process of its own, the board in real time; both boards at once, since all is waiting."""

import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from tests.support.virtual_board import CORES, VirtualBoard, virtual_board

LEASE_S = 10.0
SLACK_S = 0.5  # of a busy machine, for looking only
PATIENCE_S = 60.0


def start_daemon(folder: Path) -> "subprocess.Popen[bytes]":
    """`greenhouse run`, heating at full duty."""
    config = folder / "edge.yaml"
    settings = {
        "state_file": str(folder / "state.json"),
        "control_socket": {"path": str(folder / "daemon.sock")},
        "history": {"path": str(folder / "history.db")},
        "board": {"port": str(folder / "port")},
        "reference": {"reference_c": 36.0},
    }
    config.write_text(yaml.safe_dump(settings))
    program = [sys.executable, "-m", "edge", "run", "--config", str(config)]
    return subprocess.Popen(program, stdout=subprocess.DEVNULL)


def wait_for_heat(board: VirtualBoard, on: bool) -> None:
    """Until the heater pin is on, or off."""
    give_up = time.monotonic() + PATIENCE_S
    while board.truth()["pins"]["heater_relay"] is not on:
        assert time.monotonic() < give_up, f"the heater pin is not {'on' if on else 'off'}"
        time.sleep(0.05)


@pytest.fixture
def rigs(tmp_path):
    """A heating daemon on each board."""
    with ExitStack() as stack:
        pairs = []
        for core in CORES:
            folder = tmp_path / core
            folder.mkdir()
            board = stack.enter_context(virtual_board(folder, "--real-time", "--core", CORES[core]))
            daemon = start_daemon(folder)
            stack.callback(daemon.wait)
            stack.callback(daemon.kill)
            pairs.append((board, daemon))
        for board, _ in pairs:
            wait_for_heat(board, on=True)
        yield pairs


def check_off_within_a_lease(pairs, since_s: dict) -> None:
    """The pin goes off at most LEASE_S of the board's time after `since_s`, and stays off."""
    for board, _ in pairs:
        wait_for_heat(board, on=False)
        assert board.truth()["heater_pin_last_on_s"] <= since_s[board] + LEASE_S + SLACK_S


def test_a_killed_daemon_leaves_no_heater_on(rigs):
    since_s = {}
    for board, daemon in rigs:
        daemon.send_signal(signal.SIGKILL)
        daemon.wait()
        since_s[board] = board.truth()["time_s"]
    check_off_within_a_lease(rigs, since_s)


def test_an_unplugged_board_turns_its_heater_off_and_heats_again_when_it_is_back(rigs):
    since_s = {}
    for board, _ in rigs:
        since_s[board] = board.truth()["time_s"]
        board.inject(name="unplug", duration_s=14)
    check_off_within_a_lease(rigs, since_s)
    for board, daemon in rigs:
        wait_for_heat(board, on=True)  # the decision of the step still holds, or the next one comes
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(timeout=20) == 0
        assert not board.truth()["pins"]["heater_relay"]
