"""A page that stays open does not grow: a browser's heap and nodes after 1000 views and 50 ticks."""

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingUnixStreamServer
from typing import Any

import pytest
from history_records import START_UTC, store, tick
from selenium.webdriver.remote.webdriver import WebDriver

from edge.core.messages import Event, Forecast, Severity, TickRecord
from edge.formats.reader import parse_json
from edge.page.access import DAY_S, Role
from edge.sockets.client import encode_line
from edge.storage.file import connect
from edge.storage.tick_rows import insert_ticks
from edge.tick.orders import Operation
from edge.tick.status import LoopStatus, status_json
from tests.support.broker import free_port
from tests.support.browser import PHONE, browser
from tests.support.page_process import PageProcess

STEP_S = 60.0
FIRST_UTC = datetime(2026, 1, 1, tzinfo=UTC).timestamp()
EVENT_EVERY_TICKS = 30  # one made-up warning, and its end at the next tick
LINES = tuple(
    f"{number}. MPC-P wanted heater 0.35, fan off. Its plan costs 0.42: tracking 0.3." for number in range(12)
)
_LOOK_OFTEN = (
    "import sys; from edge.page import rig_link; rig_link.WATCHED_S = float(sys.argv[2]);"
    " from edge.page.__main__ import main; sys.exit(main(sys.argv[1]))"
)
_COUNT = """
    window.pushes = 0;
    window.courses = 0;
    window.EventSource = class extends EventSource {
      constructor(...words) {
        super(...words);
        this.addEventListener("message", () => { window.pushes += 1; });
      }
    };
    const ask = window.fetch;
    window.fetch = async (...words) => {
      const answer = await ask(...words);
      if (String(words[0]).startsWith("/api/course")) window.courses += 1;
      return answer;
    };
"""
PATIENCE_S = 60.0
pytestmark = pytest.mark.slow
pytest_plugins = ["rig_places"]

WARM_UP, VIEWS, LOOKS_A_TICK = 200, 1000, 20
LOOKS = 100  # in a row, before a moment of calm
RECORDED = 100
LOOK_S, SETTLE_S = 0.004, 1.0
LEAKS = """
    const kept = [];
    const Source = window.EventSource;
    window.EventSource = class extends Source {
      constructor(...words) {
        super(...words);
        this.addEventListener("message", (event) => {
          kept.push(JSON.parse(event.data), document.createElement("p"));
          addEventListener("resize", () => event);
        });
      }
    };
"""


def move(record: TickRecord, seq: int) -> TickRecord:
    """Return a tick as number `seq`."""
    utc = FIRST_UTC + STEP_S * seq
    events = tuple(replace(event, utc=utc) for event in record.events)
    if seq % EVENT_EVERY_TICKS < 2:
        over = ".over" if seq % EVENT_EVERY_TICKS else ""
        events += (Event(f"reading.not_good{over}", Severity.WARNING, "spike", 0.0, utc),)
    return replace(record, seq=seq, utc=utc, time_s=STEP_S * seq, events=events)


class QuickDaemon(ThreadingUnixStreamServer):
    """Answers "status" and "why" at a socket in `folder`, and goes on with the history there.

    template : its ticks, again and again; looks_a_tick : statuses until the next one
    """

    daemon_threads = True

    def __init__(self, folder: Path, template: Sequence[TickRecord], looks_a_tick: int) -> None:
        self._history, self._template, self._looks_a_tick = folder / "history.db", template, looks_a_tick
        self._lock, self.looks = threading.Lock(), 0
        self.is_still = False  # then every look sees the same
        with closing(connect(self._history, 10.0)) as connection:
            self.first_seq = 1 + int(connection.execute("SELECT max(seq) FROM ticks").fetchone()[0])
        self.record = self._tick(self.first_seq)
        super().__init__(str(folder / "daemon.sock"), _QuickAnswer)

    def answer(self, message: dict[str, Any]) -> dict[str, Any]:
        """Return the answer of a daemon."""
        if message.get("do") == "why":
            seq = self.record.seq
            return {"ok": True, "seq": seq, "lines": [f"At tick {seq}:", *LINES]}
        with self._lock:
            self.looks += not self.is_still
            looks, seq = self.looks, self.first_seq + self.looks // self._looks_a_tick
            if seq != self.record.seq:
                self.record = self._tick(seq)
                self._store(self.record)
            record = self.record
        echo = record.echo and replace(record.echo, heater_duty=0.05 * (looks % 21))
        line = {"frames": looks, "bad_crc": looks // 1000}
        return {
            "ok": True,
            **status_json(LoopStatus(Operation("MPC-P"), float(looks), (), record, echo, True, line)),
        }

    def _tick(self, seq: int) -> TickRecord:
        return move(self._template[seq % len(self._template)], seq)

    def _store(self, record: TickRecord) -> None:
        with closing(connect(self._history, 10.0)) as connection:
            connection.execute("BEGIN")
            insert_ticks(connection, [record], session=1)
            connection.execute("COMMIT")


class _QuickAnswer(StreamRequestHandler):
    def handle(self) -> None:
        """Answer one request."""
        assert isinstance(self.server, QuickDaemon)
        message = parse_json(self.rfile.readline(), "a request")
        self.wfile.write(encode_line(self.server.answer(message)))


class QuickPage(PageProcess):
    """A page that looks at its daemon every `look_s`."""

    look_s = 1.0

    @property
    def command(self) -> list[str]:
        """Return its command line."""
        return [sys.executable, "-c", _LOOK_OFTEN, str(self.config), str(self.look_s)]


@contextmanager
def quick_rig(
    folder: Path, template: Sequence[TickRecord], looks_a_tick: int, look_s: float
) -> Iterator[tuple[QuickDaemon, QuickPage]]:
    """Start both on the history in `folder`."""
    page = QuickPage(folder, free_port())
    page.look_s = look_s
    (folder / "daemon.sock").unlink(missing_ok=True)
    with QuickDaemon(folder, template, looks_a_tick) as daemon:
        threading.Thread(target=daemon.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()
        try:
            page.start()
            yield daemon, page
        finally:
            page.kill()
            daemon.shutdown()


@dataclass(frozen=True, slots=True)
class BrowserMemory:
    """JavaScript's heap, nodes of all documents and listeners, after a collection of garbage."""

    heap_mb: float
    nodes: int
    listeners: int


def count_pushes(driver: WebDriver, more: str = "") -> None:
    """Count views and courses from the next page on. more : JavaScript that runs before the page's own"""
    driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": _COUNT + more})


def pushes(driver: WebDriver) -> int:
    """Return the number of views so far."""
    return int(driver.execute_script("return window.pushes"))


def courses(driver: WebDriver) -> int:
    """Return the number of courses so far."""
    return int(driver.execute_script("return window.courses"))


def wait_for_courses(driver: WebDriver, count: int) -> None:
    """Return once so many courses have come. A page asks for one when no new tick has come for a moment."""
    _wait(courses, driver, count)


def _wait(counted: Callable[[WebDriver], int], driver: WebDriver, count: int) -> None:
    before, heard_s = 0, time.monotonic()
    while (now := counted(driver)) < count:
        if now > before:
            before, heard_s = now, time.monotonic()
        assert time.monotonic() - heard_s < PATIENCE_S, (
            f"{counted.__name__}: none within a minute, after {now}"
        )
        time.sleep(0.2)


def browser_memory(driver: WebDriver) -> BrowserMemory:
    """Collect garbage and look. Nothing should be on its way to the page."""
    driver.execute_cdp_cmd("Performance.enable", {})
    driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
    metrics = driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    found = {each["name"]: each["value"] for each in metrics}
    return BrowserMemory(found["JSHeapUsedSize"] / 1e6, int(found["Nodes"]), int(found["JSEventListeners"]))


def some_tick(seq: int) -> TickRecord:
    """A tick with an event, and with a forecast that the chart draws."""
    event = Event("limit.reached", Severity.WARNING, f"number {seq}", 0.0, START_UTC + 60.0 * seq)
    return tick(seq, events=(event,), forecasts={"arx": Forecast({1: 25.1, 15: 25.3}, {1: 0.1, 15: 0.4})})


def memory_over_views(folder: Path, script: str = "") -> tuple[BrowserMemory, BrowserMemory]:
    """Return memory after some views and after all of them.

    script : JavaScript that runs before the page's own
    """
    template = [some_tick(seq) for seq in range(1, RECORDED + 1)]
    store(folder / "history.db", *template)
    found = []
    with quick_rig(folder, template, LOOKS_A_TICK, LOOK_S) as (daemon, page), browser(PHONE) as driver:
        daemon.is_still = True
        count_pushes(driver, script)
        driver.get(f"{page.base}/#link={page.access.make_link(Role.ADMIN, 'Ann', DAY_S)}")
        for views in (WARM_UP, VIEWS):
            while pushes(driver) < views:
                look(daemon, driver)
            time.sleep(SETTLE_S)
            found.append(browser_memory(driver))
        assert [line["message"] for line in driver.get_log("browser")] == []
        return found[0], found[1]


def look(daemon: QuickDaemon, driver: WebDriver) -> None:
    """Look a hundred times, and leave the page a moment of calm, in which it draws a course."""
    until, drawn = daemon.looks + LOOKS, courses(driver)
    daemon.is_still = False
    while daemon.looks < until:
        time.sleep(0.01)
    daemon.is_still = True
    wait_for_courses(driver, drawn + 1)


def growth(before: BrowserMemory, after: BrowserMemory) -> list[str]:
    """Name what has grown by more than noise."""
    found = {
        "heap": after.heap_mb - before.heap_mb > 1.0,
        "nodes": after.nodes - before.nodes > 200,
        "listeners": after.listeners - before.listeners > 20,
    }
    return [name for name, has_grown in found.items() if has_grown]


def test_an_open_page_does_not_grow(folder: Path) -> None:
    before, after = memory_over_views(folder)
    assert growth(before, after) == [], (before, after)


def test_leaks_of_each_kind_would_be_seen(folder: Path) -> None:
    """Else the check above could not fail."""
    before, after = memory_over_views(folder, LEAKS)
    assert growth(before, after) == ["heap", "nodes", "listeners"], (before, after)
