"""The page in a real browser: what a person sees and operates, every control, and how people get in."""

import os
import re
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_core_python.selenium import Axe
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.support.select import Select

from edge.core.hard_limits import LEASE_S
from edge.page.access import Role
from edge.tick.standing_profile import duration
from tests.support.broker import free_port, wait_for
from tests.support.browser import DESK, PHONE, shared_browser
from tests.support.daemon_process import DaemonProcess
from tests.support.page_process import PageProcess, as_at_first, open_page, page_of, rig_with_page
from tests.support.virtual_board import VirtualBoard, virtual_board
from training.llm_stand_in.server import StandIn

pytestmark = pytest.mark.slow
WISH = "keep 26 by day and 20 at night"
CONTROLS = ("Set", "Automatic", "15 min", "Ask", "Start this profile", "Take the first point")
pytest_plugins = ["rig_places"]


def text(driver: WebDriver) -> str:
    return driver.find_element(By.TAG_NAME, "body").text


def tap(driver: WebDriver, words: str) -> None:
    """Tap a button by its words; in one step within the page, which draws itself anew every second."""
    found = """
        const all = [...document.querySelectorAll("button")];
        const button = all.find((each) => each.innerText === arguments[0]);
        button?.scrollIntoView({ block: "center" });
        button?.click();
        return button !== undefined;
    """
    assert driver.execute_script(found, words), (words, text(driver))


def enter(
    driver: WebDriver, page: PageProcess, role: Role, name: str = "Ann", group: str = "control"
) -> None:
    open_page(driver, page, role, name, group)
    wait_for(lambda: "confirmed by the board" in text(driver))


def complaints(driver: WebDriver) -> list[str]:
    """Lines of the browser's console, but for requests that were refused on purpose."""
    return [line["message"] for line in driver.get_log("browser") if " 4" not in line["message"]]


def serious_findings(driver: WebDriver) -> list[str]:
    """Return what a screen reader would stumble over."""
    found = Axe().run(driver)["violations"]
    return [each["id"] for each in found if each["impact"] in ("serious", "critical")]


class HastyDaemon(DaemonProcess):
    """A daemon to which ten seconds of readings are enough for a point of a calibration."""

    @property
    def command(self) -> list[str]:
        code = (
            "import sys; from edge.tick import calibration; calibration.WINDOW_S, calibration.SPAN_S = 10, 8;"
            " from edge.__main__ import main; sys.exit(main(sys.argv[1:]))"
        )
        return [sys.executable, "-c", code, "run", "--config", str(self.config)]


@pytest.fixture(scope="module")
def whole_rig() -> Iterator[tuple[DaemonProcess, PageProcess, VirtualBoard]]:
    with (
        StandIn() as model,
        rig_with_page(HastyDaemon, llm={"url": model.url, "model": "stand-in"}) as running,
    ):
        yield running


@pytest.fixture
def rig(whole_rig: tuple[DaemonProcess, PageProcess, VirtualBoard]) -> tuple[DaemonProcess, PageProcess]:
    daemon, page, _ = whole_rig
    as_at_first(daemon)
    return daemon, page


@pytest.fixture
def board(whole_rig: tuple[DaemonProcess, PageProcess, VirtualBoard]) -> VirtualBoard:
    return whole_rig[2]


def heats(board: VirtualBoard) -> bool:
    return bool(board.truth()["pins"]["heater_relay"])


@pytest.mark.parametrize(("size", "dark", "name"), [(PHONE, False, "Ann"), (DESK, True, "Bea")])
def test_a_person_sees_operates_and_nothing_is_in_the_way_of_a_screen_reader(
    rig, board, size, dark, name
) -> None:
    daemon, page = rig
    with shared_browser(size, dark) as driver:
        enter(driver, page, Role.OPERATE, name)
        wait_for(lambda: len(driver.find_elements(By.TAG_NAME, "canvas")) == 2)
        assert driver.execute_script("return document.documentElement.scrollWidth") <= size[0]
        tap(driver, "+")
        tap(driver, "Set")
        wait_for(lambda: daemon.ask("status")["operation"]["reference_c"] == 32.5)
        tap(driver, "Fan only")
        wait_for(lambda: daemon.ask("status")["operation"]["mode"] == "fan_only")
        wait_for(lambda: not heats(board))
        wait_for(lambda: f"the heater stays off. Ordered by {name} (page)." in text(driver))
        for link in driver.find_elements(By.CSS_SELECTOR, "nav a"):
            driver.execute_script("arguments[0].click()", link)
            wait_for(lambda: driver.find_elements(By.CSS_SELECTOR, ".group:not([hidden]) h2"))
            assert serious_findings(driver) == []
            assert driver.execute_script("return document.documentElement.scrollWidth") <= size[0]
        assert complaints(driver) == []


def test_health_names_the_broker_that_is_away(rig, folder: Path) -> None:
    port = free_port()
    mqtt = {"mqtt": {"enabled": True, "host": "127.0.0.1", "port": port}}
    with (
        virtual_board(folder, "--real-time"),
        DaemonProcess(folder, port),
        page_of(folder, mqtt) as page,
        shared_browser(PHONE) as driver,
    ):
        enter(driver, page, Role.VIEW, group="rig")
        wait_for(lambda: "Broker\nthe broker is gone" in text(driver))
        assert re.search(r"History\nsince .* free", text(driver))
    with shared_browser(PHONE) as driver:
        enter(driver, rig[1], Role.VIEW, group="rig")
        wait_for(lambda: "Broker\nnone is configured" in text(driver))


def profile_card(driver: WebDriver) -> str:
    return driver.find_element(By.CSS_SELECTOR, "section[aria-label=Profile]").text


def test_a_profile_is_loaded_drawn_followed_paused_skipped_and_ended(rig, tmp_path: Path) -> None:
    daemon, page = rig
    file = tmp_path / "bread.csv"
    file.write_text("time_s,reference_c\n0,25\n7200,warm\n")

    def standing() -> dict:
        return daemon.ask("status")["operation"].get("profile", {})

    with shared_browser(PHONE) as driver:
        enter(driver, page, Role.OPERATE)
        driver.execute_script("document.querySelector('section[aria-label=Profile] details').open = true")
        load = driver.find_element(By.CSS_SELECTOR, "input[type=file]")
        load.send_keys(str(file))
        wait_for(lambda: 'line 3: "7200,warm" has no two numbers there' in profile_card(driver))
        file.write_text("# a comment\ntime_s,reference_c\n0,25\n7200,31\n")
        load.send_keys(str(file))
        points = "svg.profile .point"
        wait_for(lambda: len(driver.find_elements(By.CSS_SELECTOR, points)) == 2)
        drawing = driver.find_element(By.CSS_SELECTOR, "svg.profile")
        driver.execute_script("arguments[0].scrollIntoView({ block: 'center' })", drawing)
        ActionChains(driver).move_to_element(drawing).click().perform()  # a third point, half way
        wait_for(lambda: len(driver.find_elements(By.CSS_SELECTOR, points)) == 3)
        last = driver.find_elements(By.CSS_SELECTOR, points)[2]
        ActionChains(driver).drag_and_drop_by_offset(last, 0, 24).perform()  # 4 K lower
        tap(driver, "Start this profile")
        wait_for(standing)
        found = standing()
        assert (found["name"], found["times_s"][0], found["times_s"][-1]) == ("bread", 0, 7200)
        assert found["targets_c"][0] == 25.0
        drawn_c = found["targets_c"][1]
        assert 23.0 <= drawn_c <= 27.0  # the middle of the drawing
        assert 26.0 <= found["targets_c"][2] <= 28.0
        wait_for(lambda: f"Next point: {drawn_c:.1f} °C" in profile_card(driver))
        tap(driver, "Pause")
        wait_for(lambda: standing()["paused"] and "It is paused." in profile_card(driver))
        tap(driver, "Go on")
        wait_for(lambda: not standing()["paused"])
        tap(driver, "Skip to the next point")
        wait_for(lambda: standing()["position_s"] >= found["times_s"][1])
        at = duration(found["times_s"][1])
        moved = f"Following the profile bread, {at} of 2 h 0 min. Ordered by Ann (page)."
        wait_for(lambda: moved in text(driver))
        assert serious_findings(driver) == []
        assert driver.execute_script("return document.documentElement.scrollWidth") <= PHONE[0]
        tap(driver, "End it")
        wait_for(lambda: not standing())
        assert complaints(driver) == []


ANSWER_WITH_AN_OLD_VIEW = """
    const done = arguments[0], usual = window.fetch;
    usual("/api/view").then((answer) => answer.text()).then((old) => {
        const answer = (path, options) =>
            path === "/api/view" ? Promise.resolve(new Response(old)) : usual(path, options);
        window.fetch = answer;
        done();
    });
"""
COUNT_WHAT_WAITS = """
    const { fetch } = window;
    window.waiting = 0;
    window.fetch = (...request) => {
        window.waiting += 1;
        return fetch(...request).finally(() => (window.waiting -= 1));
    };
"""
WATCH_THE_MODE = """
    window.seen = [];
    const look = () => window.seen.push(document.querySelector("header .quiet").textContent);
    const all = { subtree: true, childList: true, characterData: true };
    new MutationObserver(look).observe(document.body, all);
"""


def test_a_view_that_comes_late_does_not_bring_back_what_was(rig) -> None:
    _, page = rig
    with shared_browser(PHONE) as driver:
        enter(driver, page, Role.OPERATE, "Eva")
        driver.execute_async_script(ANSWER_WITH_AN_OLD_VIEW)
        tap(driver, "Fan only")
        wait_for(lambda: driver.find_element(By.CSS_SELECTOR, "header .quiet").text == "fan_only")
        driver.execute_script(WATCH_THE_MODE)
        tap(driver, "+")
        tap(driver, "Set")
        wait_for(lambda: "Set to 32.5 °C by hand. In mode fan_only, " in text(driver))
        assert set(driver.execute_script("return window.seen")) == {"fan_only"}


def test_a_sensor_is_calibrated_step_by_step_and_back(rig) -> None:
    daemon, page = rig

    def state() -> dict:
        return daemon.ask("status")["calibration"]["soil_moisture"]

    def card() -> str:
        return driver.find_element(By.CSS_SELECTOR, "section[aria-label=Calibration]").text

    def take(value: str, expected: str) -> None:
        """Type a value and tap until the page says what is expected."""
        # Typed over what is there: a field that is cleared first may get its old value back from the page,
        # which draws itself anew every second.
        field = driver.find_element(By.CSS_SELECTOR, "section[aria-label=Calibration] input")
        field.send_keys(Keys.CONTROL, "a", Keys.NULL, value)
        assert field.get_attribute("value") == value

        def says() -> bool:
            if expected in card():
                return True
            tap(driver, "Take the first point")
            time.sleep(0.5)
            return expected in card()

        wait_for(says, expected, 60.0)  # a point needs ten seconds of readings

    with shared_browser(PHONE) as driver:
        enter(driver, page, Role.OPERATE, group="rig")
        found = "section[aria-label=Calibration] select"
        wait_for(lambda: driver.find_elements(By.CSS_SELECTOR, found))
        choose = driver.find_element(By.CSS_SELECTOR, found)
        Select(choose).select_by_visible_text("Soil moisture")
        tap(driver, "Take the first point")
        wait_for(lambda: "type the true value" in card())
        take("40", "40 is above the largest allowed, 1")
        take("0.4", "Point 1")
        (point,) = state()["points"]
        assert point["true_value"] == 0.4
        before, after = point["raw"], 0.4
        assert abs(before - after) > 0.1  # 0.55 in this chamber
        wait_for(lambda: f"The sensor reads {before:.2f}" in card() and "and will read 0.4" in card())
        assert driver.execute_script("return document.documentElement.scrollWidth") <= PHONE[0]
        assert serious_findings(driver) == []
        driver.execute_script(COUNT_WHAT_WAITS)
        tap(driver, "Apply")
        wait_for(lambda: state()["since_utc"] is not None)
        said = ("Calibrated by hand: soil_moisture. Points to apply: none. Ordered by Ann (page).",)
        wait_for(lambda: said in daemon.rows("SELECT text FROM events WHERE key = 'operator.order'"))
        # A daemon that is killed before it answers leaves the page a time-out to complain of.
        wait_for(lambda: driver.execute_script("return window.waiting") == 0)
        daemon.kill()
        daemon.start()
        wait_for(
            lambda: abs(daemon.ask("status")["tick"]["readings"]["soil_moisture"]["value"] - after) < 0.02
        )
        wait_for(lambda: "Back to the configured calibration" in card())
        tap(driver, "Back to the configured calibration")
        wait_for(lambda: state()["since_utc"] is None)
        assert abs(state()["reads"] - before) < 0.02
        assert complaints(driver) == []


def test_one_who_looks_calibrates_nothing(rig) -> None:
    _, page = rig
    with shared_browser() as driver:
        enter(driver, page, Role.VIEW, "guest", "rig")
        wait_for(lambda: "Soil moisture" in text(driver))
        card = driver.find_element(By.CSS_SELECTOR, "section[aria-label=Calibration]")
        assert card.find_elements(By.CSS_SELECTOR, "select, button, input") == []
        refused = page.client(Role.VIEW).post("/api/order", {"do": "reset_calibration", "signal": "co2"})
        assert refused.status_code == 403


def test_the_keyboard_alone_reaches_the_stop(rig, board: VirtualBoard) -> None:
    _, page = rig
    with shared_browser() as driver:
        enter(driver, page, Role.VIEW, "guest")
        wait_for(lambda: heats(board))
        reached = driver.switch_to.active_element
        for _ in range(400):  # a page that is drawn anew meanwhile may begin at its top
            if reached.text == "STOP":
                break
            reached.send_keys(Keys.TAB)
            reached = driver.switch_to.active_element
        reached.send_keys(Keys.ENTER)
        wait_for(lambda: not heats(board))
        wait_for(lambda: "The board confirms: heater and fan are off." in text(driver))
        assert "Release the stop" not in text(driver)
        assert not [each for each in driver.find_elements(By.TAG_NAME, "section") if each.text == "Control"]


def test_with_the_daemon_hung_a_tap_stops_and_the_page_claims_nothing_that_no_board_has_said(
    rig, board: VirtualBoard
) -> None:
    daemon, page = rig
    assert daemon.ask("set_reference", reference_c=36)["ok"]
    with shared_browser(PHONE) as driver:
        enter(driver, page, Role.OPERATE)
        wait_for(lambda: heats(board))
        wait_for(lambda: "100 %" in text(driver))
        os.kill(daemon.process.pid, signal.SIGSTOP)
        try:
            tapped_s = time.monotonic()
            tap(driver, "STOP")
            wait_for(lambda: not heats(board))
            assert time.monotonic() - tapped_s <= LEASE_S + 1.0
            wait_for(lambda: "The daemon does not answer" in text(driver))
            shown = text(driver)
            assert "The board confirms" not in shown
            assert "\nconfirmed by the board" not in shown
            assert "last confirmed" in shown
            assert "waits for the daemon" in shown
        finally:
            os.kill(daemon.process.pid, signal.SIGCONT)
        wait_for(lambda: "The board confirms: heater and fan are off." in text(driver))
        assert not heats(board)
        tap(driver, "Release the stop")
        wait_for(lambda: heats(board))
        wait_for(lambda: "Emergency stop" not in text(driver).partition("Events")[0])


def test_a_killed_page_is_told_as_such_and_found_again(rig, board: VirtualBoard) -> None:
    _, page = rig
    with shared_browser() as driver:
        enter(driver, page, Role.VIEW)
        page.kill()
        wait_for(lambda: "What follows is old" in text(driver))
        assert "\nconfirmed by the board" not in text(driver)
        page.start()
        wait_for(lambda: "What follows is old" not in text(driver))
        wait_for(lambda: "confirmed by the board" in text(driver))


def test_texts_from_outside_are_texts(rig, board: VirtualBoard) -> None:
    """A name is the one text that a stranger with a link can bring into the history."""
    _, page = rig
    script = "<img src=x onerror=alert(1)>"
    with shared_browser() as driver:
        enter(driver, page, Role.OPERATE, script)
        tap(driver, "Heat only")
        wait_for(lambda: f"by {script}" in text(driver))
        assert driver.find_elements(By.CSS_SELECTOR, "img") == []


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
        wait_for(lambda: " 32.5 °C by hand." in driver.find_element(By.CLASS_NAME, "said").text)
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
        assert "The board has tripped" not in text(driver)
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
