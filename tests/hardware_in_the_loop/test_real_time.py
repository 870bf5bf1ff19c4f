"""The daemon as a process of its own, the board in real time: one on each core."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
        "bundle": {"path": str(folder / "bundles"), "trusted_keys": str(folder / "keys")},
        "reference": {"reference_c": 36.0},
        "box": {"heater_w": 100.0},
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


@contextmanager
def heating_rig(folder: Path, core: str) -> Iterator[tuple[VirtualBoard, "subprocess.Popen[bytes]"]]:
    with virtual_board(folder, "--real-time", "--core", CORES[core]) as board:
        daemon = start_daemon(folder)
        try:
            wait_for_heat(board, on=True)
            yield board, daemon
        finally:
            daemon.kill()
            daemon.wait()


def check_off_within_a_lease(board: VirtualBoard, since_s: float) -> None:
    """The pin goes off at most LEASE_S of the board's time after `since_s`, and stays off."""
    wait_for_heat(board, on=False)
    assert board.truth()["heater_pin_last_on_s"] <= since_s + LEASE_S + SLACK_S


def test_a_killed_daemon_leaves_no_heater_on(tmp_path):
    with heating_rig(tmp_path, "python") as (board, daemon):
        daemon.send_signal(signal.SIGKILL)
        daemon.wait()
        check_off_within_a_lease(board, board.truth()["time_s"])


def test_an_unplugged_board_turns_its_heater_off_and_heats_again_when_it_is_back(tmp_path):
    with heating_rig(tmp_path, "c") as (board, daemon):
        since_s = board.truth()["time_s"]
        board.inject(name="unplug", duration_s=14)
        check_off_within_a_lease(board, since_s)
        wait_for_heat(board, on=True)  # the decision of the step still holds, or the next one comes
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(timeout=20) == 0
        assert not board.truth()["pins"]["heater_relay"]
