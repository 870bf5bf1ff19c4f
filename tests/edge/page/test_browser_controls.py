"""Every control of the page in a real browser: what it orders, who has it, and how people get in."""

from collections.abc import Iterator
from typing import Any

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.support.ui import Select
from test_browser import complaints, enter, heats, tap, text

from edge.page.access import Role
from tests.support.broker import wait_for
from tests.support.browser import PHONE, shared_browser
from tests.support.daemon_process import DaemonProcess
from tests.support.page_process import PageProcess, as_at_first, rig_with_page
from tests.support.virtual_board import VirtualBoard
from training.llm_stand_in.server import StandIn

pytestmark = pytest.mark.slow
WISH = "keep 26 by day and 20 at night"
CONTROLS = ("Set", "Automatic", "15 min", "Ask", "Start this profile", "Take the first point")


@pytest.fixture(scope="module")
def whole_rig() -> Iterator[tuple[DaemonProcess, PageProcess, VirtualBoard]]:
    with StandIn() as model, rig_with_page(llm={"url": model.url, "model": "stand-in"}) as running:
        yield running


@pytest.fixture
def rig(whole_rig: tuple[DaemonProcess, PageProcess, VirtualBoard]) -> tuple[DaemonProcess, PageProcess]:
    daemon, page, _ = whole_rig
    as_at_first(daemon)
    return daemon, page


@pytest.fixture
def board(whole_rig: tuple[DaemonProcess, PageProcess, VirtualBoard]) -> VirtualBoard:
    return whole_rig[2]


def buttons(driver: WebDriver) -> set[str]:
    found = "return [...document.querySelectorAll('button')].map((each) => each.innerText)"
    return set(driver.execute_script(found))


def card(driver: WebDriver, name: str) -> str:
    return driver.find_element(By.CSS_SELECTOR, f"section[aria-label='{name}']").text


def test_every_control_of_a_person_who_operates(rig, board: VirtualBoard) -> None:
    daemon, page = rig

    def operation() -> dict[str, Any]:
        return dict(daemon.ask("status")["operation"])

    with shared_browser(PHONE) as driver:
        enter(driver, page, Role.OPERATE)
        Select(driver.find_element(By.ID, "controller")).select_by_visible_text("rules")
        wait_for(lambda: operation()["controller"] == "rules")
        tap(driver, "+")
        tap(driver, "Set")
        wait_for(lambda: operation()["reference_c"] == 32.5)
        wait_for(lambda: "Follow the programme again" in buttons(driver))
        tap(driver, "Follow the programme again")
        wait_for(lambda: operation()["reference_c"] is None)
        for words, mode in (("Off", "off"), ("Heat only", "heat"), ("Automatic", "auto")):
            tap(driver, words)
            wait_for(lambda mode=mode: operation()["mode"] == mode)
        wait_for(lambda: heats(board))
        tap(driver, "15 min")
        wait_for(lambda: operation()["maintenance_until_utc"] is not None and not heats(board))
        wait_for(lambda: "Maintenance until" in text(driver))
        tap(driver, "End it")
        wait_for(lambda: operation()["maintenance_until_utc"] is None)
        driver.find_element(By.CSS_SELECTOR, "[aria-label='What you want']").send_keys(WISH)
        tap(driver, "Ask")
        wait_for(lambda: "reference every day: 26 °C from 06:00, 20 °C from 22:00" in card(driver, "Ask"))
        assert operation()["steering"] is None
        tap(driver, "Confirm")
        wait_for(lambda: (operation()["steering"] or {}).get("words") == WISH)
        tap(driver, "Undo the last one")
        wait_for(lambda: operation()["steering"] is None)
        tap(driver, "STOP")
        wait_for(lambda: operation()["emergency_stop"])
        wait_for(lambda: "Release the stop" in buttons(driver))
        tap(driver, "Release the stop")
        wait_for(lambda: not operation()["emergency_stop"])
        assert complaints(driver) == []


def test_a_killed_daemon_is_told_and_found_again(rig, board: VirtualBoard) -> None:
    daemon, page = rig
    with shared_browser() as driver:
        enter(driver, page, Role.VIEW, "guest")
        daemon.kill()
        wait_for(lambda: "The daemon does not answer" in text(driver))
        assert "\nconfirmed by the board" not in text(driver)
        daemon.start()
        wait_for(lambda: "The daemon does not answer" not in text(driver))
        wait_for(lambda: "confirmed by the board" in text(driver))


def test_one_who_looks_has_the_stop_alone_and_an_admin_lets_people_in_and_out(rig) -> None:
    _, page = rig
    with shared_browser() as admin, shared_browser(PHONE) as guest:
        enter(admin, page, Role.ADMIN, "Ann", "rig")
        tap(admin, "Link to view for a week")
        shown = "[aria-label=link]"
        wait_for(lambda: admin.find_elements(By.CSS_SELECTOR, shown))
        link = admin.find_element(By.CSS_SELECTOR, shown).get_attribute("value")
        guest.get(str(link))
        wait_for(lambda: "confirmed by the board" in text(guest))
        seen: set[str] = set()
        for group in guest.find_elements(By.CSS_SELECTOR, "nav a"):
            guest.execute_script("arguments[0].click()", group)
            seen |= buttons(guest)
        assert not seen & set(CONTROLS)
        assert "STOP" in seen
        admin.refresh()
        wait_for(lambda: "guest (view)" in text(admin))
        tap(admin, "End")
        wait_for(lambda: "Log in" in buttons(guest))
        assert "confirmed by the board" not in text(guest)
        tap(admin, "Log out")
        wait_for(lambda: "Log in" in buttons(admin))


def test_a_person_logs_in_by_name_and_password(rig) -> None:
    _, page = rig
    page.access.set_password("Eva", Role.OPERATE, "correct horse battery")
    with shared_browser(PHONE) as driver:
        driver.get(page.base)
        wait_for(lambda: driver.find_elements(By.CSS_SELECTOR, "input[type=password]"))
        name, password = driver.find_elements(By.CSS_SELECTOR, ".door input")
        name.send_keys("Eva")
        password.send_keys("wrong horse battery")
        tap(driver, "Log in")
        wait_for(lambda: driver.find_elements(By.CSS_SELECTOR, ".door [role=alert]"))
        password.clear()
        password.send_keys("correct horse battery")
        tap(driver, "Log in")
        wait_for(lambda: "confirmed by the board" in text(driver))
        assert "Set" in buttons(driver)
