"""Whoever sees the page stops the rig, whatever the daemon does; and the page says no more than it knows."""

import asyncio
import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from edge.core.hard_limits import LEASE_S
from edge.page.access import DAY_S, Role, Visitor
from edge.page.answers import NotAllowed
from edge.page.page_state import STOPS, Page
from edge.page.protocol import CONNECTIONS_MAX, HEAD_MAX_S
from tests.support.broker import wait_for
from tests.support.daemon_process import DaemonProcess
from tests.support.page_process import Client, PageProcess, as_at_first, rig_with_page
from tests.support.virtual_board import VirtualBoard

pytestmark = pytest.mark.slow


UNFINISHED = (
    b"POST /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nSec-Fetch-Site: same-origin\r\n"
    b"Authorization: Bearer x\r\nContent-Type: application/json\r\nContent-Length: 9\r\n\r\n"
)
Rig = tuple[DaemonProcess, PageProcess, VirtualBoard]


@pytest.fixture(scope="module")
def whole_rig() -> Iterator[Rig]:
    with rig_with_page() as running:
        yield running


@pytest.fixture
def rig(whole_rig: Rig) -> Rig:
    as_at_first(whole_rig[0])
    assert whole_rig[0].ask("set_reference", reference_c=37)["ok"]  # it heats throughout
    return whole_rig


def heats(board: VirtualBoard) -> bool:
    return bool(board.truth()["pins"]["heater_relay"])


def has_stopped(client: Client) -> bool:
    view = client.view()
    status = view["status"]
    is_off = status["echo"]["heater_duty"] == 0.0 and status["echo"]["fan_share"] == 0.0
    return bool(view["reached"] and status["operation"]["emergency_stop"] and is_off)


def test_a_viewer_stops_the_rig_and_the_history_says_who(rig: Rig) -> None:
    daemon, page, board = rig
    client = page.client(Role.VIEW, "guest")
    wait_for(lambda: heats(board))
    answer = client.post("/api/stop").json()
    assert answer["ok"]
    assert "waits" not in answer
    assert not heats(board)
    wait_for(lambda: has_stopped(client))
    refused = client.post("/api/order", {"do": "release_emergency_stop"})
    assert (refused.status_code, daemon.ask("status")["operation"]["emergency_stop"]) == (403, True)
    assert page.client(Role.OPERATE).post("/api/order", {"do": "release_emergency_stop"}).ok
    wait_for(lambda: heats(board))
    daemon.wait_ticks(2)
    told = [text for (text,) in daemon.rows("SELECT text FROM events WHERE key = 'operator.order'")]
    assert told[-2:] == [
        "Emergency stop: everything is off until it is released. Ordered by guest (page).",
        "The emergency stop is released. Ordered by Ann (page).",
    ]


@pytest.mark.parametrize("begun", [b"", b"GET / HTTP/1.1\r\n", UNFINISHED])
def test_a_stop_arrives_at_once_whoever_holds_connections(rig: Rig, begun: bytes) -> None:
    daemon, page, _ = rig
    client = page.client(Role.VIEW, "guest")
    with ExitStack() as stack:
        for _ in range(CONNECTIONS_MAX + 100):
            held = stack.enter_context(socket.create_connection(("127.0.0.1", page.port), timeout=20))
            held.sendall(begun)
        begun_s = time.monotonic()
        fresh = Client(page.base)  # as a person who has just opened the page
        fresh.session.cookies.update(client.session.cookies)
        assert fresh.post("/api/stop").json()["ok"]
        assert daemon.ask("status")["operation"]["emergency_stop"]
        assert time.monotonic() - begun_s < HEAD_MAX_S / 2  # no place had to become free by itself


def test_one_link_defeats_two_releases_and_no_third_and_keeps_nobody_else_from_a_stop(rig: Rig) -> None:
    daemon, page, _ = rig
    link = page.access.make_link(Role.VIEW, "vandal", DAY_S, None)
    vandals, other = [Client(page.base) for _ in range(2)], page.client(Role.VIEW, "guest")
    for client in vandals:
        assert client.post("/api/session", {"link": link}).ok

    def stopped() -> bool:
        return bool(daemon.ask("status")["operation"]["emergency_stop"])

    for number in range(4):
        codes = {client.post("/api/stop").status_code for client in vandals * 3}
        assert (codes, stopped()) == (({200}, True) if number < STOPS else ({429}, False))
        assert daemon.ask("release_emergency_stop")["ok"]
        wait_for(lambda: not page.client().view()["status"]["operation"]["emergency_stop"])
    assert other.post("/api/stop").ok and stopped()
    assert vandals[0].post("/api/order", {"do": "stop"}).status_code in (200, 429) and stopped()


class ReleasedRig:
    """A rig that is released after every stop."""

    def __init__(self, reached: bool = True) -> None:
        self.reached, self.stopped = reached, 0

    def view(self) -> dict[str, bool]:
        return {"reached": self.reached}

    async def ask(self, request: object) -> dict[str, object]:
        return {"ok": True, "operation": {"emergency_stop": False}} if self.reached else {"ok": False}

    async def stop(self, author: str) -> dict[str, bool]:
        self.stopped += 1
        return {"ok": True, "changed": True}


def test_the_limit_of_one_who_looks_is_nobody_elses_and_none_while_the_daemon_is_silent() -> None:
    rig = ReleasedRig()
    page = Page(None, None, rig, None, None, None)  # type: ignore[arg-type]

    def stop(session: int, name: str, link: int = 0) -> None:
        asyncio.run(page.stop(Visitor(session, name, Role.VIEW, link), name))

    for visitor in ((1, "Eve"), (2, "guest", 7)):
        for _ in range(STOPS):
            stop(*visitor)
        with pytest.raises(NotAllowed):
            stop(*visitor)
    stop(3, "Ann")  # logs in by a password, as Eve does
    stop(4, "guest", 8)
    assert rig.stopped == 2 * STOPS + 2
    rig.reached = False
    stop(1, "Eve")
    assert rig.stopped == 2 * STOPS + 3


def test_with_the_daemon_hung_a_stop_leaves_the_heater_off_within_a_lease_and_for_good(rig: Rig) -> None:
    daemon, page, board = rig
    client = page.client(Role.VIEW, "guest")
    wait_for(lambda: heats(board) and client.view()["status"]["echo"]["heater_duty"] > 0.0)
    assert daemon.process is not None
    os.kill(daemon.process.pid, signal.SIGSTOP)
    try:
        tapped_s = time.monotonic()
        answer = client.post("/api/stop").json()
        assert answer["ok"]
        assert answer["waits"]
        wait_for(lambda: not heats(board))
        assert time.monotonic() - tapped_s <= LEASE_S + 1.0
        wait_for(lambda: not client.view()["reached"])
        view = client.view()
        # The last that the board has echoed, with its age: nobody has said that the heater is off.
        assert view["status"]["echo"]["heater_duty"] > 0.0
        assert view["silent_s"] > 2.0
        assert view["stop_waits"]["by"] == "guest (page)"
    finally:
        os.kill(daemon.process.pid, signal.SIGCONT)
    wait_for(lambda: has_stopped(client))
    last = daemon.wait_ticks(3)
    assert not heats(board)
    wait_for(lambda: client.view()["stop_waits"] is None)
    wait_for(lambda: daemon.seqs()[-1] >= last)
    assert daemon.rows("SELECT DISTINCT mode FROM ticks ORDER BY seq DESC LIMIT 1") == [("emergency_stop",)]


def test_a_stop_without_a_daemon_waits_for_the_next_one(rig: Rig) -> None:
    daemon, page, board = rig
    client = page.client(Role.VIEW)
    wait_for(lambda: heats(board))
    daemon.kill()
    before = daemon.seqs()[-1]
    assert client.post("/api/stop").json()["waits"]
    wait_for(lambda: not heats(board))
    daemon.start()
    daemon.wait_ticks(2)
    assert not heats(board)
    sent = f"SELECT max(sent_heater_duty), min(mode) FROM ticks WHERE seq > {before}"
    assert daemon.rows(sent) == [(0.0, "emergency_stop")]
    wait_for(lambda: has_stopped(client))
    # It was taken: after a release nothing stops the next daemon.
    assert page.client().post("/api/order", {"do": "release_emergency_stop"}).ok
    daemon.kill()
    daemon.start()
    wait_for(lambda: heats(board))


def test_a_page_that_is_killed_hurts_nobody_and_its_sessions_live(rig: Rig) -> None:
    daemon, page, _ = rig
    client = page.client()
    page.kill()
    daemon.wait_ticks(2)
    page.start()
    wait_for(lambda: client.view()["reached"])
    assert client.get("/api/me").json()["name"] == "Ann"
