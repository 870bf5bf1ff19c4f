"""Memory of an open page in a browser, and the number of views and courses that have come to it."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from selenium.webdriver.remote.webdriver import WebDriver

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
