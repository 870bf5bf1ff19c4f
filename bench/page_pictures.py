"""python -m bench.page_pictures: the manual's pictures of the page, from a demo of six simulated hours.

On a phone and on a desk, light and dark. Needs chromium and chromedriver.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webdriver import WebDriver

from edge.core.processes import end_process
from tests.support.broker import wait_for
from tests.support.browser import DESK, PHONE, browser
from tests.support.daemon_process import ROOT

IMAGES = ROOT / "docs" / "images"
SPEED, MINUTES = 900.0, 300.0
SETTLE_S = 2.0  # for the last answers and the chart


def take(address: str, folder: Path) -> None:
    """Write a picture of each group of cards: `page_360.png`, `page_twin_360.png` and so on."""
    for size, is_dark in ((PHONE, False), (DESK, True)):
        with browser(size, is_dark) as driver:
            driver.get(address)
            wait_for(lambda: "confirmed by the board" in driver.find_element(By.TAG_NAME, "body").text)
            time.sleep(SETTLE_S)
            save(driver, folder / f"page_{size[0]}.png")
            for group in ("twin", "rig"):
                driver.execute_script("location.hash = arguments[0]", group)
                time.sleep(SETTLE_S)
                bar = driver.find_element(By.TAG_NAME, "nav")
                driver.execute_script("arguments[0].scrollIntoView()", bar)
                save(driver, folder / f"page_{group}_{size[0]}.png")


def save(driver: WebDriver, path: Path) -> None:
    """Write what the window shows. Errors: OSError, where Selenium says nothing"""
    path.write_bytes(driver.get_screenshot_as_png())


def main() -> int:
    """Run the demo and take the pictures."""
    parser = argparse.ArgumentParser(prog="python -m bench.page_pictures", description=__doc__)
    parser.add_argument("--images", type=Path, default=IMAGES, help="folder; default: docs/images")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="gh-") as name:
        command = [sys.executable, "-m", "edge", "demo", "--speed", str(SPEED), "--out", name]
        demo = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=ROOT)
        try:
            assert demo.stderr is not None
            lines = (line.decode() for line in iter(demo.stderr.readline, b""))
            address = next(line.split()[-1] for line in lines if "#link=" in line)
            time.sleep(60.0 * MINUTES / SPEED)
            take(address, given.images)
        finally:
            end_process(demo, patience_s=15.0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
