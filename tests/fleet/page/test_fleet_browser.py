"""The fleet's page in a real browser: on a phone, by keyboard alone, with names that look like HTML."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fleet_browser import PATIENCE_S, as_new, is_within, log_in, serious_findings, text
from fleet_pages import PASSWORD, STATE, FleetPageOfTest, fleet_page
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver
from sqlalchemy.orm import Session

from edge.page.access import Role
from fleet.database.base import open_database
from fleet.database.twins import ToldTwin
from fleet.settings import NumbersSettings
from tests.support.broker import free_port, wait_for
from tests.support.browser import DESK, PHONE

pytestmark = pytest.mark.slow
EVIL = '<img src=x onerror="document.title=1">'


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
