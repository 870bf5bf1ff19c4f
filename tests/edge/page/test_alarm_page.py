"""The whole page as a process with a daemon: alarms of a hung daemon, roles, the card, what is secret."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from alarm_servers import HttpSink, http_sink
from selenium.webdriver.common.by import By

from edge.page.access import Role
from edge.page.alarms import alarm_state
from tests.support.broker import free_port, wait_for
from tests.support.browser import PHONE, shared_browser
from tests.support.daemon_process import ROOT, DaemonProcess
from tests.support.page_process import PageProcess, open_page, page_of
from tests.support.virtual_board import VirtualBoard

pytestmark = pytest.mark.slow
pytest_plugins = ["rig_places"]

SECRET = "t0ps3cret"
MEMORY_MAX_KB = 60_000


@pytest.fixture
def sink() -> Iterator[HttpSink]:
    with http_sink() as running:
        yield running


def settings(sink: HttpSink) -> dict[str, Any]:
    return {
        "silent_s": 5,
        "webhook": {"url": f"{sink.url}/{SECRET}"},
        "life_sign": {"url": f"{sink.url}/{SECRET}-ping", "every_s": 10},
    }


def named(sink: HttpSink) -> list[tuple[str, str]]:
    """Return cause and state of all alarms that were told."""
    heard = [one.json() for one in sink.heard if one.method == "POST"]
    return [(alarm["cause"], alarm["state"]) for document in heard for alarm in document["alarms"]]


def signs(sink: HttpSink) -> int:
    return sum(one.method == "GET" for one in sink.heard)


def is_noted(page: PageProcess) -> bool:
    """Return whether the page has saved that it told each of its alarms: until then, a kill repeats one."""
    alarms = alarm_state.load(page.access).alarms
    return bool(alarms) and all(alarm.deliveries for alarm in alarms)


def hang(daemon: DaemonProcess) -> None:
    assert daemon.process is not None
    os.kill(daemon.process.pid, signal.SIGSTOP)


def go_on(daemon: DaemonProcess) -> None:
    assert daemon.process is not None
    os.kill(daemon.process.pid, signal.SIGCONT)


def test_a_hung_daemon_is_told_and_its_signs_of_life_end(
    folder: Path, board: VirtualBoard, sink: HttpSink
) -> None:
    with DaemonProcess(folder) as daemon, page_of(folder, {"alarms": settings(sink)}) as page:
        wait_for(lambda: signs(sink))
        hang(daemon)
        try:
            wait_for(lambda: ("daemon.silent", "alarm") in named(sink))
            before = signs(sink)
            withheld = page.client().get("/api/alarms").json()["life_sign"]["withheld"]
            assert withheld == "the daemon does not answer"
            wait_for(lambda: is_noted(page))
            page.kill()
            page.start()  # a restart does not tell it again
            wait_for(lambda: page.client().get("/api/alarms").json()["alarms"])
        finally:
            go_on(daemon)
        wait_for(lambda: ("daemon.silent", "over") in named(sink))
        wait_for(lambda: signs(sink) > before)
        assert named(sink).count(("daemon.silent", "alarm")) == 1
        status = Path(f"/proc/{page.process.pid}/status").read_text() if page.process else ""
        memory_kb = int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])
        assert memory_kb < MEMORY_MAX_KB
        assert SECRET not in (folder / "page.log").read_text()


def test_a_missing_board_is_one_alarm_however_many_events_say_so(folder: Path, sink: HttpSink) -> None:
    with DaemonProcess(folder) as daemon, page_of(folder, {"alarms": settings(sink)}):
        wait_for(lambda: ("board.silent", "alarm") in named(sink))
        wait_for(lambda: daemon.has_event("board.port_missing"))
        daemon.wait_ticks(5)
        assert [one for one in named(sink) if one[0] == "board.silent"] == [("board.silent", "alarm")]


def test_roles_and_secrets(folder: Path, sink: HttpSink) -> None:
    with page_of(folder, {"alarms": settings(sink)}) as page:
        viewer, operator, admin = (page.client(role) for role in Role)
        assert page.client(None).get("/api/alarms").status_code == 401
        assert viewer.get("/api/alarms").status_code == 403
        assert SECRET not in operator.get("/api/alarms").text
        for client, status in ((viewer, 403), (operator, 403), (admin, 200)):
            assert client.post("/api/alarms/test", {"channel": "webhook"}).status_code == status
        (test,) = (one.json() for one in sink.heard if one.method == "POST")
        assert test["kind"] == "test"
        assert viewer.post("/api/alarms/acknowledge", {"id": 1}).status_code == 403
        for values in ({"id": 1}, {"id": "x"}, {"id": 1e11}, {}):
            assert operator.post("/api/alarms/acknowledge", values).status_code == 400
        for values in ({"channel": "ntfy"}, {"channel": "<b>"}, {"channel": 5}, {}):
            assert admin.post("/api/alarms/test", values).status_code in (400, 429)
        sink.status = 401
        codes = [admin.post("/api/alarms/test", {"channel": "webhook"}).status_code for _ in range(6)]
        assert codes[-1] == 429
        assert "127.0.0.1 answers 401 Unauthorized" in operator.get("/api/alarms").text
        assert (
            admin.post("/api/alarms/test", {"channel": "webhook"}, origin="http://evil.example").status_code
            == 403
        )


def test_the_command_line_says_for_each_channel_whether_it_works(folder: Path, sink: HttpSink) -> None:
    broken = {"ntfy": {"url": f"http://127.0.0.1:{free_port()}/{SECRET}"}}
    with page_of(folder, {"alarms": settings(sink) | broken}) as page:
        done = subprocess.run(
            [sys.executable, "-m", "edge", "page", "--config", str(page.config), "test-alarm"],
            capture_output=True, text=True, cwd=ROOT, timeout=90, check=False,
        )  # fmt: skip
    lines = dict(line.split(maxsplit=1) for line in done.stdout.splitlines())
    assert done.returncode == 1, done
    assert lines["webhook"] == "arrived"
    assert lines["ntfy"] == "127.0.0.1: Connection refused"
    assert "withheld" in lines["life_sign"]  # there is no daemon
    assert SECRET not in done.stdout + done.stderr


def test_the_card_tests_and_acknowledges_on_a_phone(
    folder: Path, board: VirtualBoard, sink: HttpSink
) -> None:
    with (
        DaemonProcess(folder),
        page_of(folder, {"alarms": settings(sink)}) as page,
        shared_browser(PHONE) as driver,
    ):
        open_page(driver, page, group="rig")

        def card() -> str:
            found = driver.find_elements(By.CSS_SELECTOR, "[aria-label='Alarms by message']")
            return found[0].text if found else ""

        def tap(selector: str) -> None:
            driver.execute_script("document.querySelector(arguments[0]).click()", selector)

        wait_for(lambda: "Webhook" in card())
        tap("[aria-label='Test Webhook']")
        wait_for(lambda: "arrived" in card())
        sink.status = 503
        tap("[aria-label='Test Webhook']")
        wait_for(lambda: "answers 503 Service Unavailable" in card())
        sink.status = 200
        assert driver.execute_script("return document.documentElement.scrollWidth") <= PHONE[0]
        page.client().post("/api/stop")
        wait_for(lambda: "the emergency stop is pressed" in card())
        tap("[aria-label='Alarms by message'] .events button")
        wait_for(lambda: "seen by Ann" in card())
        assert SECRET not in json.dumps(page.client().get("/api/alarms").json())


def test_without_a_channel_the_card_says_how_to_set_one_up(folder: Path) -> None:
    with page_of(folder) as page:
        answer = page.client().get("/api/alarms").json()
        assert answer == {"ok": True, "channels": [], "life_sign": None, "alarms": []}
        done = subprocess.run(
            [sys.executable, "-m", "edge", "page", "--config", str(page.config), "test-alarm"],
            capture_output=True, text=True, cwd=ROOT, timeout=90, check=False,
        )  # fmt: skip
        assert done.returncode == 2
        assert "no channel is configured" in done.stderr
