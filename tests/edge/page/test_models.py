"""Bundles and adoptions by way of the page, with the whole daemon and a real diagnosis."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from bundles import Workshop
from test_browser import complaints, enter, tap, text

from edge.__main__ import main
from edge.app.nightly_diagnosis import ADOPT_MAX_S
from edge.formats.run_file import absence_facts, write_run
from edge.page.access import Role
from edge.twin.twin_file import write_twin_file
from tests.support.broker import wait_for
from tests.support.browser import PHONE, shared_browser
from tests.support.daemon_process import DaemonProcess
from tests.support.page_process import Client, PageProcess, page_of
from tests.support.simulated_runs import BOX, simulate, twin_file
from tests.support.virtual_board import virtual_board

pytestmark = pytest.mark.slow
TICK_MAX_S = 90.0  # a step of 60 s: the packaged models are made for it
REPORT = "2026-07-01_0300"


@pytest.fixture(scope="module")
def report() -> Iterator[Path]:
    """The report of a real diagnosis: a box whose heater is slow, and a twin that does not know it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = simulate({**BOX, "heater_lag": {"tau_h": 240.0}}, 1, 420)
        write_run(absence_facts(run), folder / "run.csv")
        write_twin_file(twin_file(), folder / "given.yaml")
        given = [str(folder / "run.csv"), "--twin", str(folder / "given.yaml")]
        assert main(["twin", "diagnose", *given, "--out", str(folder / REPORT)]) == 0
        yield folder / REPORT


@pytest.fixture(scope="module")
def rig(report: Path) -> Iterator[tuple[DaemonProcess, PageProcess]]:
    """A rig with a report, a key that it trusts, a bundle that was damaged and a twin of a stranger's."""
    with tempfile.TemporaryDirectory(prefix="gh-") as name:
        folder = Path(name)
        shop = Workshop(folder)
        shutil.copytree(report, folder / "reports" / REPORT)
        for version in ("1.0", "2.0"):
            shutil.copytree(
                shop.signed_folder(f"of-{version}", version=version), folder / "bundles" / version
            )
        (folder / "bundles" / "2.0" / "arx.json").write_text("{}")
        sections = {
            "control": {"model": "", "controller": "rules", "step_s": 60},
            "bundle": {
                "path": str(folder / "bundles"),
                "trusted_keys": str(shop.trusted),
                "signing_key": str(shop.key),
            },
            "drift": {"reports": str(folder / "reports"), "adopt": "never"},
        }
        with (
            virtual_board(folder, "--real-time"),
            DaemonProcess(folder, **sections) as daemon,
            page_of(folder, {"drift": sections["drift"]}) as page,
        ):
            yield daemon, page


def models(client: Client) -> dict[str, Any]:
    """Return the list of bundles, once the daemon has looked."""
    wait_for(lambda: not client.get("/api/models").json()["looking"])
    return dict(client.get("/api/models").json())


def carried_out(client: Client, **order: Any) -> str:
    """The error of an order, "" where it was carried out."""
    begun = client.post("/api/order", order).json()
    assert begun["ok"], begun
    asked = {"do": order["do"], "job": begun["job"]}
    asked |= {"action": "status"} if order["do"] == "bundle" else {}
    wait_for(lambda: client.post("/api/order", asked).json()["job_done"], "the job", 60.0)
    return str(client.post("/api/order", asked).json()["job_error"])


def test_a_viewer_sees_all_models_and_changes_none(rig) -> None:
    daemon, page = rig
    found = models(page.client(Role.VIEW, "guest"))
    bundles = {bundle["version"]: bundle for bundle in found["bundles"]}
    assert list(bundles) == ["packaged", "1.0", "2.0"]
    assert (found["active"], found["back_to"], found["undo"]) == ("packaged", None, None)
    assert bundles["1.0"]["models"] == ["arx", "pbm"]
    assert "arx.json: has 2 bytes" in bundles["2.0"]["problem"]
    for role in (Role.VIEW, Role.OPERATE):
        client = page.client(role)
        for order in (
            {"do": "bundle", "action": "activate", "version": "1.0"},
            {"do": "bundle", "action": "rollback"},
            {"do": "bundle", "action": "undo-adoption"},
            {"do": "adopt", "report": REPORT},
        ):
            refused = client.post("/api/order", order)
            assert (refused.status_code, "needs the role admin" in refused.json()["error"]) == (403, True)
    assert daemon.ask("bundle", action="status")["active"] == "packaged"


def test_what_the_daemon_refuses_is_told_with_its_reason(rig) -> None:
    daemon, page = rig
    admin = page.client()
    for order, reason in (
        ({"do": "bundle", "action": "activate", "version": "9"}, "bundle 9 is not installed"),
        ({"do": "bundle", "action": "activate", "version": "2.0"}, "arx.json: has 2 bytes"),
        ({"do": "bundle", "action": "activate", "version": "../2.0"}, "is no version of a bundle"),
        ({"do": "bundle", "action": "rollback"}, "the packaged bundle is active"),
        ({"do": "bundle", "action": "rollback", "version": "1.0"}, "1.0 is not active any more"),
        ({"do": "bundle", "action": "undo-adoption"}, "no adopted twin runs"),
    ):
        assert reason in carried_out(admin, **order)
    for name in ("no_such", "../bundles", "/etc", "", None):
        refused = admin.post("/api/order", {"do": "adopt", "report": name})
        assert (refused.status_code, "adopt: report" in refused.json()["error"]) == (400, True)
    assert daemon.ask("bundle", action="status")["active"] == "packaged"


def test_a_bundle_is_activated_and_rolled_back(rig) -> None:
    _, page = rig
    admin = page.client()
    assert carried_out(admin, do="bundle", action="activate", version="1.0") == ""
    found = models(admin)
    assert (found["active"], found["on_probation"], found["back_to"]) == ("1.0", True, "packaged")
    assert carried_out(page.client(name="Bob"), do="bundle", action="rollback", version="1.0") == ""
    assert models(admin)["active"] == "packaged"


def test_a_twin_is_adopted_and_taken_back_with_a_tap_and_a_yes(rig) -> None:
    daemon, page = rig

    def status() -> dict[str, Any]:
        return daemon.ask("bundle", action="status")

    with shared_browser(PHONE) as driver:
        enter(driver, page, Role.ADMIN, group="twin")
        wait_for(lambda: "One effect is missing: the element warms up" in text(driver))
        assert driver.execute_script("return document.documentElement.scrollWidth") <= PHONE[0]
        tap(driver, "Adopt")
        wait_for(lambda: f"Run the twin of {REPORT} beside packaged?" in text(driver))
        assert driver.switch_to.active_element.text == "No"
        driver.switch_to.active_element.click()
        assert driver.switch_to.active_element.text == "Adopt"
        assert status()["rival"] is None  # nothing happens without a yes
        tap(driver, "Adopt")
        tap(driver, "Yes, adopt")
        wait_for(lambda: "has an adopted twin and runs beside" in text(driver), "adoption", ADOPT_MAX_S)
        version = status()["rival"]
        found = models(page.client(Role.VIEW))
        bundle = next(bundle for bundle in found["bundles"] if bundle["version"] == version)
        assert (found["shadow"], found["undo"], found["active"]) == (version, version, "packaged")
        assert "heater_lag" in bundle["effects"] and bundle["adopted_from"]
        other = {"do": "bundle", "action": "undo-adoption", "version": "1.0-twin-00000000"}
        refused = carried_out(page.client(), **other)
        assert refused == f"bundle 1.0-twin-00000000 is not in shadow any more: {version} is"
        tap(driver, "Undo")
        tap(driver, "Yes, undo")
        wait_for(lambda: "has an adopted twin" not in text(driver))
        assert (status()["rival"], status()["active"]) == (None, "packaged")
        driver.execute_script("document.querySelector('[aria-label=Diagnosis] summary').click()")
        wait_for(lambda: "tau_h = " in text(driver) and "The whole report, with pictures" in text(driver))
        assert complaints(driver) == []


def test_a_viewer_has_no_button_that_would_be_refused(rig) -> None:
    _, page = rig
    with shared_browser() as driver:
        enter(driver, page, Role.VIEW, "guest", "twin")
        wait_for(lambda: "One effect is missing: the element warms up" in text(driver))
        words = {button.text for button in driver.find_elements("css selector", "main button")}
        assert not {"Activate", "Adopt", "Adopt and activate", "Roll back", "Undo"} & words
        assert "Save as CSV" in words


def test_events_and_why_say_by_whom(rig) -> None:
    """The tests before have done it; the last tick took it up, or the next one does."""
    daemon, page = rig

    def told(key: str) -> list[str]:
        return [words for (words,) in daemon.rows(f"SELECT text FROM events WHERE key = '{key}'")]

    wait_for(lambda: told("bundle.undo-adoption") and told("bundle.rollback"), "the next tick", TICK_MAX_S)
    assert told("bundle.undo-adoption") == ["asked for, by Ann (page); packaged is active"]
    assert told("bundle.rollback") == ["asked for, by Bob (page); packaged is active"]
    assert told("bundle.activate")[0].startswith("asked for, by Ann (page); 1.0 is active, on probation")
    [adopted] = told("diagnosis.adopted")
    assert adopted.startswith(f"the twin of {REPORT} is adopted: ")
    assert adopted.endswith(", by Ann (page)")
    told_at = "SELECT t.utc FROM events e JOIN ticks t ON t.seq = e.seq WHERE e.key = 'bundle.rollback'"
    [(utc,)] = daemon.rows(told_at)
    lines = page.client().get(f"/api/why?at_utc={utc}").json()["lines"]
    assert any("asked for, by Bob (page); packaged is active (bundle.rollback)" in line for line in lines)
