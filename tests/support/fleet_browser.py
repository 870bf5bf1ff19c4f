"""Steps of every test of the fleet's page in a real browser: log in, read, look for what is in the way."""

from axe_core_python.selenium import Axe
from fleet_pages import PASSWORD, FleetPageOfTest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver

from tests.support.broker import wait_for
from tests.support.browser import DESK, resize

PATIENCE_S = 40.0


def text(driver: WebDriver) -> str:
    return driver.find_element(By.TAG_NAME, "body").text


def as_new(driver: WebDriver, size: tuple[int, int] = DESK, dark: bool = False) -> WebDriver:
    """Return a browser that knows nobody, with a window of this size [CSS pixels]."""
    driver.delete_all_cookies()
    resize(driver, size)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
    return driver


def log_in(driver: WebDriver, page: FleetPageOfTest, name: str = "Ann") -> None:
    """Log in as a person does who has no mouse, and wait for the list of rigs."""
    driver.get(page.base)
    wait_for(lambda: driver.find_elements(By.CSS_SELECTOR, "input[type=password]"), "the door", PATIENCE_S)
    driver.find_element(By.CSS_SELECTOR, "input[autocomplete=username]").send_keys(name, Keys.TAB, PASSWORD)
    driver.switch_to.active_element.send_keys(Keys.ENTER)
    wait_for(lambda: driver.find_elements(By.CSS_SELECTOR, ".rigs a"), "the list of rigs", PATIENCE_S)


def serious_findings(driver: WebDriver) -> list[str]:
    """Return what a screen reader would stumble over."""
    found = Axe().run(driver)["violations"]
    return [each["id"] for each in found if each["impact"] in ("serious", "critical")]


def is_within(driver: WebDriver, size: tuple[int, int]) -> bool:
    return bool(driver.execute_script("return document.documentElement.scrollWidth") <= size[0])
