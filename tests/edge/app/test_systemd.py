"""Notices to the service manager: what they say, and when the daemon sends them."""

import os
import select
import signal
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from edge.app.systemd import WATCHDOG_MIN_S, Notifier, watchdog_s
from edge.config.settings import ControlSettings
from tests.support.broker import wait_for
from tests.support.daemon_process import ROOT, DaemonProcess
from tests.support.virtual_board import VirtualBoard, virtual_board

pytestmark = pytest.mark.slow

PATIENCE_S = 20.0
RULES = {"model": "", "controller": "rules", "fallback": "rules"}  # need no model for 1 s


class ServiceManager:
    """The socket at the other end of $NOTIFY_SOCKET."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address)

    def hear(self, timeout_s: float = PATIENCE_S) -> dict[str, str]:
        """The next notice; empty when none comes in time."""
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return {}
        lines = self._socket.recv(4096).decode().split("\n")
        return dict(line.split("=", 1) for line in lines)

    def hear_all(self) -> list[dict[str, str]]:
        """All that has come."""
        notices = []
        while notice := self.hear(0.0):
            notices.append(notice)
        return notices

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ServiceManager]:
    manager = ServiceManager(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", manager.address)
    monkeypatch.setenv("WATCHDOG_USEC", "150000000")
    yield manager
    manager.close()


@pytest.fixture
def board(tmp_path: Path) -> Iterator[VirtualBoard]:
    with virtual_board(tmp_path, "--real-time") as board:
        yield board


@pytest.fixture
def daemon(tmp_path: Path, manager: ServiceManager, board: VirtualBoard) -> Iterator[DaemonProcess]:
    with DaemonProcess(tmp_path, control={"step_s": 1, **RULES}) as daemon:
        yield daemon


def tick(notice: dict[str, str]) -> int:
    """Number of the tick that a status names: "tick 12, rules, mode auto"."""
    return int(notice["STATUS"].split(",")[0].removeprefix("tick "))


def pings(manager: ServiceManager, count: int) -> Sequence[int]:
    """The ticks of the next pings."""
    heard = [manager.hear() for _ in range(count)]
    assert all(notice.get("WATCHDOG") == "1" for notice in heard), heard
    return [tick(notice) for notice in heard]


def follow_on(ticks: Sequence[int]) -> bool:
    return list(ticks) == list(range(ticks[0], ticks[0] + len(ticks)))


# what a notice says


@pytest.mark.parametrize("step_s", [1.0, 5.9, 6.0, 6.1, 60.0, 600.0])
def test_the_watchdog_is_over_two_steps_and_never_short(step_s: float) -> None:
    assert watchdog_s(step_s) > 2 * step_s
    assert watchdog_s(step_s) >= WATCHDOG_MIN_S


def test_readiness_sets_the_watchdog_to_the_step(manager: ServiceManager) -> None:
    notifier = Notifier.from_environment()
    notifier.ready("tick 1", 600.0)
    notifier.close()
    assert manager.hear() == {"READY": "1", "STATUS": "tick 1", "WATCHDOG_USEC": "1500000000"}


def test_a_watchdog_that_is_off_stays_off(manager: ServiceManager, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WATCHDOG_USEC")
    notifier = Notifier.from_environment()
    notifier.ready("tick 1", 60.0)
    notifier.close()
    assert manager.hear() == {"READY": "1", "STATUS": "tick 1"}


def test_an_abstract_socket_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"greenhouse-test-{os.getpid()}"
    manager = ServiceManager(f"\0{name}")
    monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}")
    notifier = Notifier.from_environment()
    notifier.alive("tick 1")
    notifier.close()
    assert manager.hear() == {"WATCHDOG": "1", "STATUS": "tick 1"}
    manager.close()


def test_without_a_manager_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notifier = Notifier.from_environment()
    notifier.ready("", 60.0)
    notifier.alive("")
    notifier.stopping()
    notifier.close()


def test_a_manager_that_is_gone_or_does_not_listen_holds_nothing_up(manager: ServiceManager) -> None:
    notifier = Notifier.from_environment()
    for number in range(1000):  # far more than a socket's queue holds
        notifier.alive(f"tick {number}")
    manager.close()
    notifier.alive("tick 1000")
    notifier.close()


# when the daemon says it


def test_ready_comes_after_the_first_tick_and_a_ping_with_every_tick(
    daemon: DaemonProcess, manager: ServiceManager
) -> None:
    ready = manager.hear()
    assert ready["READY"] == "1"
    assert ready["WATCHDOG_USEC"] == f"{watchdog_s(1.0) * 1e6:.0f}"
    assert tick(ready) == 1
    heard = pings(manager, 4)
    assert heard[0] == 1
    assert follow_on(heard)
    wait_for(lambda: daemon.log.count("  tick ") >= 4, "the log has each of them as well")


def test_an_unplugged_board_is_no_reason_for_a_restart(
    daemon: DaemonProcess, manager: ServiceManager, board: VirtualBoard
) -> None:
    board.inject(name="unplug", duration_s=1000)
    wait_for(lambda: not daemon.ask("status")["tick"]["link_up"])
    manager.hear_all()
    assert follow_on(pings(manager, 3))


def test_a_hung_loop_does_not_ping_and_its_heater_goes_off(
    daemon: DaemonProcess, manager: ServiceManager, board: VirtualBoard
) -> None:
    wait_for(lambda: board.truth()["pins"]["heater_relay"])
    assert daemon.process is not None
    daemon.process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, daemon.process.pid, os.WSTOPPED)
    manager.hear_all()
    wait_for(lambda: not board.truth()["pins"]["heater_relay"])  # by the lease
    assert manager.hear_all() == []
    daemon.process.send_signal(signal.SIGCONT)
    assert pings(manager, 1)


def test_sigterm_turns_the_heater_off_says_so_and_ends_well(
    daemon: DaemonProcess, manager: ServiceManager, board: VirtualBoard
) -> None:
    wait_for(lambda: board.truth()["pins"]["heater_relay"])
    assert daemon.stop() == 0
    assert not board.truth()["pins"]["heater_relay"]
    assert manager.hear_all()[-1] == {"STOPPING": "1"}


def test_a_configuration_that_is_refused_ends_in_one_line_and_exit_code_2(
    tmp_path: Path, manager: ServiceManager
) -> None:
    daemon = DaemonProcess(tmp_path, control={"step_s": 1, "model": ""})
    daemon.launch()
    assert daemon.process is not None
    assert daemon.process.wait(PATIENCE_S) == 2
    assert daemon.log.startswith(
        "greenhouse run: control.model: the packaged model is made for steps of 60 s"
    )
    assert daemon.log.count("\n") == 1
    assert manager.hear_all() == []


def test_the_units_watchdog_is_that_of_the_default_step() -> None:
    unit = (ROOT / "deploy" / "greenhouse.service").read_text()
    assert f"WatchdogSec={watchdog_s(ControlSettings().step_s):g}\n" in unit
