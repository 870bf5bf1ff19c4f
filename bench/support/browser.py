"""Debian's Chromium for tests, without a window."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from selenium import webdriver
from selenium.webdriver.remote.webdriver import WebDriver

PHONE, DESK = (360, 780), (1440, 1000)
PROGRAM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")


@contextmanager
def browser(size: tuple[int, int] = DESK, dark: bool = False) -> Iterator[WebDriver]:
    """Yield a browser with a profile of its own."""
    assert PROGRAM and DRIVER, "apt install chromium chromium-driver"
    options = webdriver.ChromeOptions()
    options.binary_location = PROGRAM
    for word in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    try:
        width, height = size
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        yield driver
    finally:
        driver.quit()
