"""The fleet's page in a real browser: on a phone, by keyboard alone, with names that look like HTML."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from axe_core_python.selenium import Axe
from fleet_pages import PASSWORD, STATE, FleetPageOfTest, fleet_page
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver
from sqlalchemy.orm import Session

from edge.page.access import Role
from fleet.database.base import open_database
from fleet.database.tables import BundleRollout, RolloutRig, RolloutWave, ToldTwin
from fleet.settings import NumbersSettings
from tests.support.broker import free_port, wait_for
from tests.support.browser import DESK, PHONE, resize
from tests.support.held_rollout import add_held_rollout

PATIENCE_S = 40.0
pytestmark = pytest.mark.slow
EVIL = '<img src=x onerror="document.title=1">'
LONG = "a-kind-with-a-long-name-" * 2


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


@pytest.fixture
def page(tmp_path: Path) -> Iterator[FleetPageOfTest]:
    with fleet_page(tmp_path, numbers=NumbersSettings(url=f"http://127.0.0.1:{free_port()}")) as running:
        for number in range(30):
            running.add_rig(f"rig-{number:02}", "north" if number % 2 else "south", "tent")
        running.add_rig(EVIL, "north", EVIL, state=STATE | {"tripped": 1, "trips": EVIL})
        running.add_rig("cold", "north", last_utc=time.time() - 7200.0)
        twin = {"effects": {"wall_loss": {"UA": {"value": 5.123456}}, EVIL: {EVIL: 1.0}}}
        with Session(open_database(running.settings.database)) as session, session.begin():
            session.add(ToldTwin(rig="rig-07", bundle=EVIL, utc=1.7e9, document=twin))
        running.people.add("Ann", "north", Role.OPERATE, PASSWORD)
        yield running


@pytest.mark.parametrize(("size", "dark"), [(PHONE, False), (DESK, True)])
def test_a_person_finds_the_worst_rig_and_nothing_is_in_the_way(  # type: ignore[no-untyped-def]
    page: FleetPageOfTest, chromium: WebDriver, size, dark
) -> None:
    driver = as_new(chromium, size, dark)
    log_in(driver, page)
    rows = driver.find_elements(By.CSS_SELECTOR, ".rigs a")
    assert [row.text.splitlines()[0] for row in rows[:3]] == ["cold", EVIL, "rig-01"]
    assert len(rows) == 17  # those of the group alone
    assert is_within(driver, size)
    assert serious_findings(driver) == []
    driver.find_element(By.CSS_SELECTOR, "input[type=search]").send_keys("rig-07")
    wait_for(lambda: len(driver.find_elements(By.CSS_SELECTOR, ".rigs a")) == 1, "the search", PATIENCE_S)
    driver.find_element(By.CSS_SELECTOR, ".rigs a").send_keys(Keys.ENTER)
    wait_for(lambda: "The last day" in text(driver), "the rig", PATIENCE_S)
    wait_for(lambda: "numbers.url" in text(driver), "why there is no picture", PATIENCE_S)
    assert "wall_loss UA 5.123" in text(driver).replace("\n", " ")
    assert is_within(driver, size)
    assert serious_findings(driver) == []
    driver.find_element(By.CSS_SELECTOR, "nav a[href='#alarms']").send_keys(Keys.ENTER)
    wait_for(lambda: "There is none." in text(driver), "the alarms", PATIENCE_S)
    assert serious_findings(driver) == []
    assert driver.title == "Greenhouses"


def test_a_name_that_looks_like_html_is_text(page: FleetPageOfTest, chromium: WebDriver) -> None:
    driver = as_new(chromium)
    log_in(driver, page)
    next(row for row in driver.find_elements(By.CSS_SELECTOR, ".rigs a") if EVIL in row.text).click()
    wait_for(lambda: f"tripped: {EVIL}" in text(driver), "the rig", PATIENCE_S)
    assert not driver.find_elements(By.CSS_SELECTOR, "img[src=x]")
    assert driver.title == "Greenhouses"
    # An order that cannot be given says why, beside its button.
    driver.find_element(By.XPATH, "//button[text()='Heat only']").click()
    wait_for(lambda: "mqtt.enabled is false" in text(driver), "the refusal", PATIENCE_S)


@pytest.fixture
def rollout_page(tmp_path: Path) -> Iterator[FleetPageOfTest]:
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


def find_rollout(driver: WebDriver, rollout_page: FleetPageOfTest, name: str) -> None:
    """Log in and come to the rollout by the line above the rigs."""
    log_in(driver, rollout_page, name)
    wait_for(lambda: "Rollout 1 is held and waits for a person" in text(driver), "the line", PATIENCE_S)
    driver.find_element(By.CSS_SELECTOR, ".trouble.warn a").send_keys(Keys.ENTER)
    wait_for(lambda: "Wave 1 is held" in text(driver), "the rollout", PATIENCE_S)


@pytest.mark.parametrize(("size", "dark"), [(PHONE, True), (DESK, False)])
def test_an_admin_lets_a_held_wave_go_on_and_then_stops_it(  # type: ignore[no-untyped-def]
    rollout_page: FleetPageOfTest, chromium: WebDriver, size, dark
) -> None:
    engine = open_database(rollout_page.settings.database)
    driver = as_new(chromium, size, dark)
    find_rollout(driver, rollout_page, "Ann")
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
    rollout_page: FleetPageOfTest, chromium: WebDriver
) -> None:
    driver = as_new(chromium)
    find_rollout(driver, rollout_page, "Ben")
    assert "somebody with the role admin decides" in text(driver)
    assert not driver.find_elements(By.CSS_SELECTOR, "main button, main input")
    driver = as_new(chromium)
    find_rollout(driver, rollout_page, "Ann")
    # A page that nobody looks at asks nothing, so it does not learn of it before the button is pressed.
    driver.execute_script(
        "window.isAway = true; Object.defineProperty(document, 'hidden', {get: () => window.isAway})"
    )
    with Session(open_database(rollout_page.settings.database)) as session, session.begin():
        session.get_one(RolloutWave, (1, 1)).state = "passed"
    press(driver, "Let it go on")
    wait_for(lambda: "wave 1 is passed: only one that is held" in text(driver), "why", PATIENCE_S)
    driver.execute_script("window.isAway = false")
    wait_for(lambda: "Wave 1: passed" in text(driver), "what has happened meanwhile", PATIENCE_S)
    assert "only one that is held" in text(driver)
    assert not driver.find_elements(By.XPATH, "//button[text()='Let it go on']")
