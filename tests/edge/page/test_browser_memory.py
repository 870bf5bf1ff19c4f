"""A page that stays open does not grow: a browser's heap and nodes after 1000 views and 50 ticks."""

import time
from pathlib import Path

import pytest
from history_records import START_UTC, store, tick
from selenium.webdriver.remote.webdriver import WebDriver

from edge.core.messages import Event, Forecast, Severity, TickRecord
from edge.page.access import DAY_S, Role
from tests.support.browser import PHONE, browser
from tests.support.browser_memory import (
    BrowserMemory,
    browser_memory,
    count_pushes,
    courses,
    pushes,
    wait_for_courses,
)
from tests.support.quick_daemon import QuickDaemon, quick_rig

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
