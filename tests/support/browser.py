"""Debian's Chromium for tests, without a window."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from selenium import webdriver
from selenium.webdriver.remote.webdriver import WebDriver

PHONE, DESK = (360, 780), (1440, 1000)
PROGRAMS = {"chromium": "chromium", "chromium-driver": "chromedriver"}  # Debian package -> program
# As root Chromium needs --no-sandbox; the last four keep it from calling its maker.
OPTIONS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"),
    *("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
)


@contextmanager
def browser(size: tuple[int, int] = DESK, dark: bool = False) -> Iterator[WebDriver]:
    """Yield a browser with a profile of its own."""
    assert not missing(), f"apt install {' '.join(missing())}"
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for word in OPTIONS:
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        resize(driver, size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        yield driver
    finally:
        driver.quit()


def resize(driver: WebDriver, size: tuple[int, int]) -> None:
    """Give the window a size [CSS pixels]; a narrow one is a phone's."""
    width, height = size
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def missing() -> list[str]:
    """Return the Debian packages that are still to be installed."""
    return [name for name, program in PROGRAMS.items() if shutil.which(program) is None]
