"""The card Memory in a real browser on a phone: a refusal with its reason, a note, its edit and its end."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver.common.by import By
from test_browser import complaints, enter, serious_findings, tap

from edge.page.access import Role
from tests.support.broker import wait_for
from tests.support.browser import PHONE, shared_browser
from tests.support.daemon_process import DaemonProcess
from tests.support.page_process import PageProcess, rig_with_page
from training.llm_stand_in.server import StandIn

pytestmark = pytest.mark.slow
WISH = "keep 26 by day and 20 at night"
NOTE = "<b>no fan</b> between 22:00 and 07:00"


@pytest.fixture(scope="module")
def rig() -> Iterator[tuple[DaemonProcess, PageProcess]]:
    with StandIn() as model, rig_with_page(llm={"url": model.url, "model": "stand-in"}) as (daemon, page, _):
        yield daemon, page


def test_a_reason_and_a_note_are_remembered_edited_and_forgotten(rig: Any) -> None:
    daemon, page = rig

    def facts() -> list[tuple[str, str]]:
        return [(fact["kind"], fact["text"]) for fact in daemon.ask("memory")["facts"]]

    with shared_browser(PHONE) as driver:
        enter(driver, page, Role.OPERATE, "Ann")

        def fill(label: str, words: str) -> None:
            def typed() -> bool:  # a field that the page draws anew meanwhile has its old words again
                box = driver.find_element(By.CSS_SELECTOR, f"[aria-label='{label}']")
                box.clear()
                box.send_keys(words)
                return box.get_attribute("value") == words

            wait_for(typed)

        def card() -> str:
            return driver.find_element(By.CSS_SELECTOR, "section[aria-label='Memory']").text

        wait_for(lambda: "Nothing is remembered yet" in card())
        fill("What you want", WISH)
        tap(driver, "Ask")
        wait_for(lambda: driver.find_elements(By.CSS_SELECTOR, "[aria-label='Why not']"))
        fill("Why not", "the basil wilts")
        tap(driver, "Discard")
        wait_for(lambda: "discarded by Ann (page)" in card())
        (kind, text), *_ = facts()
        assert kind == "discarded"
        assert text.startswith(f'"{WISH}"; because: the basil wilts; settings: reference every day: 26 °C')
        assert daemon.ask("status")["operation"]["steering"] is None

        fill("A note", NOTE)
        tap(driver, "Note it")
        wait_for(lambda: NOTE in card())  # as text, not as HTML
        assert facts()[0] == ("note", NOTE)
        width = driver.execute_script("return document.documentElement.scrollWidth")
        assert serious_findings(driver) == []
        if picture := os.environ.get("MEMORY_PICTURE"):
            section = driver.find_element(By.CSS_SELECTOR, "section[aria-label='Memory']")
            Path(picture).write_bytes(section.screenshot_as_png)
        assert width <= PHONE[0]
        tap(driver, "Edit")
        fill("Text", "no fan at night")
        tap(driver, "Save")
        wait_for(lambda: "note by Ann (page), edited" in card())
        assert facts()[0] == ("note", "no fan at night")
        tap(driver, "Edit")
        tap(driver, "Forget")
        wait_for(lambda: "no fan at night" not in card())
        assert [kind for kind, _ in facts()] == ["discarded"]
        assert complaints(driver) == []


def test_who_only_looks_sees_and_changes_no_memory(rig: Any) -> None:
    daemon, page = rig
    before = daemon.ask("memory")["facts"]
    with shared_browser(PHONE) as driver:
        enter(driver, page, Role.VIEW, "guest")
        assert not driver.find_elements(By.CSS_SELECTOR, "section[aria-label='Memory']")
    client = page.client(Role.VIEW)
    for order in ({"do": "memory"}, {"do": "remember", "text": "x"}, {"do": "forget", "all": True}):
        assert client.post("/api/order", order).status_code == 403
    assert daemon.ask("memory")["facts"] == before != []
