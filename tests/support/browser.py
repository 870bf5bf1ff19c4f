"""Debian's Chromium for tests, without a window."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from selenium import webdriver
from selenium.webdriver.chrome.webdriver import WebDriver

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
    driver = _start()
    try:
        _show(driver, size, dark)
        yield driver
    finally:
        driver.quit()


_idle: list[WebDriver] = []


@contextmanager
def shared_browser(size: tuple[int, int] = DESK, dark: bool = False) -> Iterator[WebDriver]:
    """Yield a browser that other tests used before, unless they failed; it has forgotten them."""
    driver = _idle.pop() if _idle else _start()
    try:
        _show(driver, size, dark)
        yield driver
        _forget(driver)
    except BaseException:
        driver.quit()
        raise
    _idle.append(driver)


def quit_shared_browsers() -> None:
    """End them; `tests/conftest.py` calls this."""
    while _idle:
        _idle.pop().quit()


def _start() -> WebDriver:
    assert not missing(), f"apt install {' '.join(missing())}"
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for word in OPTIONS:
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))


def _show(driver: WebDriver, size: tuple[int, int], dark: bool) -> None:
    resize(driver, size)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})


def _forget(driver: WebDriver) -> None:
    """Forget the pages seen, as a new profile would."""
    origin = driver.execute_script("return location.origin")
    driver.get("about:blank")
    if origin.startswith("http"):
        driver.execute_cdp_cmd("Storage.clearDataForOrigin", {"origin": origin, "storageTypes": "all"})
    driver.execute_cdp_cmd("Network.clearBrowserCookies", {})
    driver.get_log("browser")


def resize(driver: WebDriver, size: tuple[int, int]) -> None:
    """Give the window a size [CSS pixels]; a narrow one is a phone's."""
    width, height = size
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def missing() -> list[str]:
    """Return the Debian packages that are still to be installed."""
    return [name for name, program in PROGRAMS.items() if shutil.which(program) is None]
