"""Reports of diagnoses on the page: a right one is shown, a half-written or hostile one hurts nobody."""

import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnosis_examples import STORIES
from selenium.webdriver.common.by import By

from edge.core.errors import DataError
from edge.diagnosis.diagnosis_file import write_json
from edge.diagnosis.report.page import write_report
from edge.page import reports
from edge.page.access import Role
from edge.twin.twin_file import TwinFile, write_twin_file
from tests.support.broker import wait_for
from tests.support.browser import shared_browser
from tests.support.page_process import Client, PageProcess, open_page, page_of

pytestmark = pytest.mark.slow
EVIL = "<script>document.title='owned'</script>"
HOSTILE_PAGE = f"""<!doctype html><title>A report</title><meta http-equiv="refresh" content="0;url=/evil">
{EVIL}<img src="/api/me" onerror="document.title='owned'"><iframe src="/"></iframe>
<form action="/api/stop" method="post"><button id="send">Send</button></form>
<link rel="stylesheet" href="/style.css"><p id="end">Its text</p>"""


def document(name: str = "named", **keys: Any) -> dict[str, Any]:
    return {**STORIES[name]().document, **keys}


def write(folder: Path, content: bytes | str | dict[str, Any]) -> Path:
    """A report whose diagnosis is this, checked by nobody."""
    folder.mkdir(parents=True)
    text = json.dumps(content) if isinstance(content, dict) else content
    (folder / "diagnosis.json").write_bytes(text.encode() if isinstance(text, str) else text)
    return folder


@pytest.fixture(scope="module")
def home() -> Iterator[Path]:
    """A folder with a page's files and reports."""
    with tempfile.TemporaryDirectory(prefix="gh-") as name:
        folder = Path(name)
        for verdict in STORIES:
            write_report(folder / "reports" / verdict, STORIES[verdict]())
        write_twin_file(TwinFile(), folder / "reports" / "named" / "twin.yaml")
        (folder / "reports" / "named" / "next_experiment.csv").touch()
        effects = [{**effect, "name": EVIL} for effect in document()["effects"]]
        hostile = write(folder / "reports" / "hostile", document(effects=effects, findings=[EVIL] * 3))
        (hostile / "report.html").write_text(HOSTILE_PAGE)
        write(folder / "reports" / "half", json.dumps(document())[:5000])
        yield folder


@pytest.fixture(scope="module")
def page(home: Path) -> Iterator[PageProcess]:
    with page_of(home, {"drift": {"reports": str(home / "reports")}}) as running:
        yield running


@pytest.fixture(scope="module")
def guest(page: PageProcess) -> Client:
    return page.client(Role.VIEW, "guest")


def listed(guest: Client) -> dict[str, Any]:
    return {each["name"]: each for each in guest.get("/api/diagnoses").json()["reports"]}


def test_each_report_is_listed_with_its_verdict_in_a_sentence(guest: Client) -> None:
    found = listed(guest)
    assert found["named"]["headline"].startswith(
        "Two effects are missing: the element warms up before it heats (heater_lag) and share of the rated"
    )
    assert "of the gap is closed" in found["named"]["gap"]
    assert found["named"]["has_twin"]
    assert found["nothing_missing"]["headline"].startswith("Nothing is missing")
    assert found["unknown"]["headline"].startswith("Something is missing that has no name here")
    assert not found["unknown"]["has_twin"]
    assert found["hostile"]["has_html"]
    assert "not JSON" in found["half"]["problem"]


def test_a_report_has_figures_evidence_and_the_next_experiment_with_its_command(
    guest: Client, home: Path
) -> None:
    found = guest.get("/api/diagnoses/named").json()
    assert [row[0] for row in found["figures"]] == ["training runs", "held-out test runs"]
    assert found["effects"][0]["text"] == (
        "the element warms up before it heats (heater_lag): tau_h dP/dt = H - P"
    )
    assert found["effects"][0]["evidence"][0] == "tau_h = 418 s (95 %: 402 to 435)"
    assert "cannot tell it from" in found["effects"][1]["evidence"][-1]
    assert "short_circuit" in found["effects"][1]["evidence"][-1]
    assert found["experiment"]["why"]
    profile = home / "reports" / "named" / "next_experiment.csv"
    assert f"greenhouse experiment {profile} --out " in found["experiment"]["commands"][1]
    assert guest.get("/api/diagnoses/nothing_missing").json()["effects"] == []
    broken = guest.get("/api/diagnoses/half")
    assert (broken.status_code, "half: diagnosis.json: not JSON" in broken.json()["error"]) == (503, True)


def test_a_report_is_served_so_that_nothing_in_it_can_act(guest: Client) -> None:
    answer = guest.get("/api/diagnoses/named/report")
    assert answer.headers["content-type"].startswith("text/html")
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:;")
    assert "script" not in policy and "allow" not in policy
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.text.count("<svg") > 3
    # Every other route still has the page's own policy.
    assert guest.get("/api/diagnoses").headers["content-security-policy"].startswith("default-src 'self'")


def test_a_hostile_report_does_nothing_in_a_browser(page: PageProcess) -> None:
    with shared_browser() as driver:
        open_page(driver, page, group="twin")
        wait_for(lambda: "Diagnosis" in driver.find_element(By.TAG_NAME, "body").text)
        wait_for(lambda: EVIL in driver.find_element(By.CSS_SELECTOR, "[aria-label=Diagnosis]").text)
        assert driver.title == "Greenhouse"
        address = f"{page.base}/api/diagnoses/hostile/report"
        driver.get(address)
        wait_for(lambda: "Its text" in driver.find_element(By.TAG_NAME, "body").text)
        driver.find_element(By.ID, "send").click()
        assert driver.find_element(By.ID, "end").is_displayed()
        assert (driver.title, driver.current_url) == ("A report", address)
        said = " ".join(line["message"] for line in driver.get_log("browser"))
        assert "Blocked script execution" in said
    assert page.client().view()["stop_waits"] is None  # the form was not sent


@pytest.mark.parametrize(
    "name",
    ["..", "%2e%2e", "..%2freports%2fnamed", "named%2f..%2fnamed", "%2fetc", "named%00", ".hidden", "link",
     "named%2freport.html", "file", "no_such", "N%C3%84ME"],
)  # fmt: skip
def test_a_name_that_is_not_in_the_listing_leads_nowhere(guest: Client, home: Path, name: str) -> None:
    folder = home / "reports"
    if not (folder / ".hidden").exists():
        write(folder / ".hidden", document())
        write(folder / "NÄME", document())
        write(home / "elsewhere", document())
        (folder / "link").symlink_to(home / "elsewhere")
        (folder / "file").touch()
    for path in (f"/api/diagnoses/{name}", f"/api/diagnoses/{name}/report"):
        answer = guest.get(path)
        assert answer.status_code in (400, 404), path
    assert set(listed(guest)) == {*STORIES, "hostile", "half"}


def test_a_link_in_a_report_leads_to_nothing_that_only_the_page_may_read(guest: Client, home: Path) -> None:
    report = write(home / "reports" / "zz_links", b"")
    try:
        (report / "diagnosis.json").unlink()
        for name in ("diagnosis.json", "report.html", "log.txt"):
            (report / name).symlink_to(home / "page" / "page.db")
        assert listed(guest)["zz_links"]["problem"] == "zz_links: diagnosis.json is a link"
        refused = guest.get("/api/diagnoses/zz_links/report")
        assert (refused.status_code, b"SQLite" in refused.content) == (503, False)
    finally:
        for path in report.iterdir():
            path.unlink()
        report.rmdir()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "not JSON"),
        (b"\xff\xfe", "not JSON"),
        (b"[]", "not JSON"),
        (b"[" * 200_000, "not JSON"),
        (b" " * (reports.DOCUMENT_MAX + 1), "larger than 1024 kB"),
        (json.dumps({"verdict": "named"}), "effects: missing"),
        (json.dumps(document()).replace("812.4", "NaN"), "NaN is not JSON"),
        (document(verdict="no such"), "'no such' is none of named"),
        (document(gap={}), "gap.before: missing"),
        (document(effects=[]), "the verdict is `named`, but no effect is"),
    ],
)
def test_a_diagnosis_that_is_none_is_listed_with_the_reason(
    tmp_path: Path, content: Any, reason: str
) -> None:
    report = write(tmp_path / "bad", content)
    [found] = reports.summaries(tmp_path)
    assert reason in found["problem"]
    assert not found["has_twin"]
    with pytest.raises(DataError, match="diagnosis"):
        reports.details(report)


def test_a_lone_surrogate_and_a_control_character_are_no_trouble_for_json(tmp_path: Path) -> None:
    effect = {**document()["effects"][0], "name": "\ud800\x00\x1b[31m\u202e"}
    write(tmp_path / "odd", document(effects=[effect]))
    text = json.dumps([reports.summaries(tmp_path), reports.details(tmp_path / "odd")], ensure_ascii=False)
    assert text.encode()
    assert not {"\x00", "\x1b", "\u202e"} & set(text)


def test_a_report_on_its_way_has_no_result_yet_and_then_its_verdict(tmp_path: Path) -> None:
    report = tmp_path / "2026-07-01_0300"
    report.mkdir()
    (report / "log.txt").write_text("reading\n 62 % free runs\n")
    [found] = reports.summaries(tmp_path)
    assert found["problem"].startswith("No result: it is under way, or ended without one.")
    assert found["problem"].endswith("62 % free runs")
    (report / "diagnosis.json").write_text("{")  # by a writer that is no writer of ours
    assert "not JSON" in reports.summaries(tmp_path)[0]["problem"]
    write_json(report / "diagnosis.json", document())
    assert reports.summaries(tmp_path)[0]["headline"].startswith("Two effects are missing")
    (report / "diagnosis.json").unlink()
    os.mkfifo(report / "diagnosis.json")  # opening it would wait for ever
    assert "cannot be read: not a regular file" in reports.summaries(tmp_path)[0]["problem"]


def test_the_newest_come_first_and_not_all_of_them(tmp_path: Path) -> None:
    for k in range(reports.REPORTS_MAX + 5):
        report = write(tmp_path / f"r{k:02d}", document())
        os.utime(report / "diagnosis.json", (1000.0 + k, 1000.0 + k))
    found = [each["name"] for each in reports.summaries(tmp_path)]
    assert (len(found), found[0], found[-1]) == (reports.REPORTS_MAX, "r34", "r05")


def test_a_real_report_is_read() -> None:
    cases = Path(__file__).parents[3] / "training" / "results" / "paper_case"
    found = {each["name"]: each for each in reports.summaries(cases)}
    assert found["interpolation"]["problem"] == ""
    assert "wall_mass" in found["interpolation"]["headline"]
    [train, test] = reports.details(cases / "interpolation")["figures"]
    assert (train[0], test[0]) == ("training runs", "held-out test runs")


def test_where_there_is_no_folder_there_is_no_report(tmp_path: Path) -> None:
    assert reports.summaries(tmp_path / "none") == []
