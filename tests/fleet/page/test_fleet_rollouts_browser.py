"""Rollouts in a real browser: found from the list of rigs, decided about by keyboard, on phone and desk."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fleet_browser import PATIENCE_S, as_new, is_within, log_in, serious_findings, text
from fleet_pages import PASSWORD, FleetPageOfTest, fleet_page
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver
from sqlalchemy.orm import Session

from edge.page.access import Role
from fleet.database.base import open_database
from fleet.database.bundles import BundleRollout, RolloutRig, RolloutWave
from tests.support.broker import wait_for
from tests.support.browser import DESK, PHONE
from tests.support.held_rollout import add_held_rollout

pytestmark = pytest.mark.slow
EVIL = '<img src=x onerror="document.title=1">'
LONG = "a-kind-with-a-long-name-" * 2


@pytest.fixture
def page(tmp_path: Path) -> Iterator[FleetPageOfTest]:
    with fleet_page(tmp_path) as running:
        kinds = {f"rig-{number:02}": (LONG, EVIL)[number % 2] for number in range(6)}
        for rig, kind in kinds.items():
            running.add_rig(rig, "north", kind)
        with Session(open_database(running.settings.database)) as session, session.begin():
            rollout = add_held_rollout(session, time.time(), kinds, "north", EVIL, unsure=[EVIL])
            row = session.get_one(RolloutRig, (rollout.number, "rig-01"))
            row.state, row.why = "refused", EVIL
        running.people.add("Ann", "north", Role.ADMIN, PASSWORD)
        running.people.add("Ben", "north", Role.OPERATE, PASSWORD)
        yield running


def press(driver: WebDriver, words: str) -> None:
    """Press a button as somebody does who has no mouse."""
    driver.find_element(By.XPATH, f"//button[text()='{words}']").send_keys(Keys.ENTER)


def come_to(driver: WebDriver, part: str, words: str) -> None:
    """Come to a part of the page by its tab."""
    driver.find_element(By.CSS_SELECTOR, f"nav a[href='{part}']").send_keys(Keys.ENTER)
    wait_for(lambda: driver.find_elements(By.XPATH, f"//main[contains(., '{words}')]"), words, PATIENCE_S)


def find_rollout(driver: WebDriver, page: FleetPageOfTest, name: str) -> None:
    """Log in and come to the rollout by the line above the rigs."""
    log_in(driver, page, name)
    wait_for(lambda: "Rollout 1 is held and waits for a person" in text(driver), "the line", PATIENCE_S)
    driver.find_element(By.CSS_SELECTOR, ".trouble.warn a").send_keys(Keys.ENTER)
    wait_for(lambda: "Wave 1 is held" in text(driver), "the rollout", PATIENCE_S)


@pytest.mark.parametrize(("size", "dark"), [(PHONE, True), (DESK, False)])
def test_an_admin_lets_a_held_wave_go_on_and_then_stops_it(  # type: ignore[no-untyped-def]
    page: FleetPageOfTest, chromium: WebDriver, size, dark
) -> None:
    engine = open_database(page.settings.database)
    driver = as_new(chromium, size, dark)
    find_rollout(driver, page, "Ann")
    for words in ("5 active, 1 refused", f"refused: {EVIL}", f"Bundle {EVIL} for group north", "-1.3 %"):
        assert words in text(driver)
    assert not driver.find_elements(By.CSS_SELECTOR, "img[src=x]")
    assert driver.title == "Greenhouses"
    assert is_within(driver, size)
    assert serious_findings(driver) == []
    driver.find_element(By.CSS_SELECTOR, "input[aria-label=Why]").send_keys("few tents")
    press(driver, "Let it go on")
    wait_for(lambda: "Ann let it go on: few tents" in text(driver), "the wave that passed", PATIENCE_S)
    come_to(driver, "#", "rig-00")
    assert "waits for a person" not in text(driver)
    come_to(driver, "#bundles", "Bundle")
    assert not driver.find_elements(By.XPATH, "//button[text()='Let it go on']")
    press(driver, "Stop and roll back")
    wait_for(lambda: "cannot be taken up again" in text(driver), "the question", PATIENCE_S)
    assert serious_findings(driver) == []
    press(driver, "Leave it")
    with Session(engine) as session:
        assert session.get_one(BundleRollout, 1).state == "running"  # asked once is not enough
    press(driver, "Stop and roll back")
    press(driver, "Stop it now")
    wait_for(lambda: "Ann stopped it" in text(driver), "the end", PATIENCE_S)
    assert "1 refused, 5 rolling back" in text(driver)
    assert not driver.find_elements(By.CSS_SELECTOR, "main button")
    with Session(engine) as session:
        assert session.get_one(BundleRollout, 1).why == "Ann stopped it"


def test_who_may_not_decide_sees_it_and_a_decision_that_comes_late_says_why(
    page: FleetPageOfTest, chromium: WebDriver
) -> None:
    driver = as_new(chromium)
    find_rollout(driver, page, "Ben")
    assert "somebody with the role admin decides" in text(driver)
    assert not driver.find_elements(By.CSS_SELECTOR, "main button, main input")
    driver = as_new(chromium)
    find_rollout(driver, page, "Ann")
    # A page that nobody looks at asks nothing, so it does not learn of it before the button is pressed.
    driver.execute_script(
        "window.isAway = true; Object.defineProperty(document, 'hidden', {get: () => window.isAway})"
    )
    with Session(open_database(page.settings.database)) as session, session.begin():
        session.get_one(RolloutWave, (1, 1)).state = "passed"
    press(driver, "Let it go on")
    wait_for(lambda: "wave 1 is passed: only one that is held" in text(driver), "why", PATIENCE_S)
    driver.execute_script("window.isAway = false")
    wait_for(lambda: "Wave 1: passed" in text(driver), "what has happened meanwhile", PATIENCE_S)
    assert "only one that is held" in text(driver)
    assert not driver.find_elements(By.XPATH, "//button[text()='Let it go on']")
