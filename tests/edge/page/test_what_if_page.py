"""*What if* on the page: a short process answers, for everybody who may look, and a crowd costs no more."""

import asyncio
import os
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from axe_core_python.selenium import Axe
from selenium.webdriver.common.by import By

from edge.core.errors import RequestError
from edge.page import questions
from edge.page.access import Role
from edge.page.answers import Json, NotAllowed
from edge.page.questions import BURST, KEEP_MAX, TwinQuestions, options, run_command
from tests.support.broker import wait_for
from tests.support.browser import PHONE, shared_browser
from tests.support.page_process import Client, PageProcess, open_page, page_of

CARD = 'section[aria-label="What if"]'
ASKED = "/api/what-if?reach_c=35&room_c=20&hold_c=28"


@pytest.fixture(scope="module")
def page() -> Iterator[PageProcess]:
    """A page without a daemon: its twin is the packaged one."""
    with tempfile.TemporaryDirectory(prefix="gh-") as name, page_of(Path(name)) as running:
        yield running


@pytest.fixture
def viewer(page: PageProcess) -> Client:
    return page.client(Role.VIEW, "guest")


def status_kb(pid: int, key: str) -> int:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key))


def children(pid: int) -> list[str]:
    return [
        word
        for task in Path(f"/proc/{pid}/task").iterdir()
        for word in (task / "children").read_text().split()
    ]


@pytest.mark.slow
def test_a_viewer_gets_now_and_the_change_and_the_page_stays_small(page: PageProcess, viewer: Client) -> None:
    found = viewer.get(f"{ASKED}&heater_w=150").json()
    assert found["ok"] and found["twin"] == "the packaged bundle"
    assert found["verdict"].startswith("With the change: Yes: 35 °C takes ")
    rows = {row["row"]: row for row in found["rows"]}
    reach = rows["full heat for good"]
    assert reach["now"]["value"] < reach["changed"]["low"]
    assert any("packaged twin" in limit for limit in found["limits"])
    assert page.process is not None
    pid = page.process.pid
    assert status_kb(pid, "VmHWM") < 60_000
    assert "numpy" not in Path(f"/proc/{pid}/maps").read_text()
    assert children(pid) == []
    now = viewer.get(ASKED).json()
    assert {row["changed"] for row in now["rows"]} == {None}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("query", "named"),
    [
        ("", "reach_c: a number is needed"),
        ("reach_c=35", "room_c: a number is needed"),
        ("reach_c=35&room_c=warm", "room_c: a number is needed"),
        ("reach_c=35&room_c=20&heater_w=nan", "heater_w: a number is needed"),
        ("reach_c=35&room_c=20&heater_w=1e400", "heater_w: a number is needed"),
        ("reach_c=35&room_c=20&heater_w=--twin=/etc/passwd", "heater_w: a number is needed"),
        ("reach_c=35&room_c=20&twin=/etc/passwd", "twin: unknown; known are"),
        ("reach_c=35&room_c=20&wall=" + "x" * 50, "wall: a text of 1 to 40"),
        ("reach_c=35&room_c=20&heater_w=-5", "--heater-w"),
        ("reach_c=99&room_c=20", "--reach"),
        ("reach_c=35&room_c=20&walls_mm=16&wall=--twin", "'--twin' is none of"),
    ],
)  # fmt: skip
def test_a_number_that_makes_no_sense_is_named(viewer: Client, query: str, named: str) -> None:
    answer = viewer.get(f"/api/what-if?{query}")
    if answer.status_code == 429:  # the allowance of new questions is spent by the tests before
        time.sleep(questions.EVERY_S)
        answer = viewer.get(f"/api/what-if?{query}")
    assert answer.status_code == 400
    assert named in answer.json()["error"]


@pytest.mark.slow
def test_a_crowd_waits_and_everything_else_goes_on(page: PageProcess, viewer: Client) -> None:
    assert page.process is not None
    pid, most, ended = page.process.pid, [0], threading.Event()

    def watch() -> None:
        while not ended.wait(0.01):
            most[0] = max(most[0], len(children(pid)))

    def ask(k: int) -> int:
        client = clients[k % len(clients)]
        url = f"{page.base}{ASKED}&heater_w={100 + k}"
        return int(client.session.get(url, timeout=questions.ANSWER_MAX_S * BURST).status_code)

    clients = [page.client(Role.VIEW, f"guest {k}") for k in range(8)]
    watching = threading.Thread(target=watch)
    watching.start()
    try:
        with ThreadPoolExecutor(40) as pool:
            codes = [pool.submit(ask, k) for k in range(40)]
            assert viewer.view()["ok"]
            assert viewer.post("/api/stop").json()["ok"]
            found = [each.result() for each in codes]
    finally:
        ended.set()
        watching.join()
    assert set(found) <= {200, 429, 503}
    assert found.count(200) <= BURST + 2
    assert most[0] <= 1


@pytest.mark.slow
def test_without_a_session_nobody_asks(page: PageProcess) -> None:
    assert page.client(None).get(ASKED).status_code == 401


@pytest.mark.slow
def test_a_person_with_a_phone_asks_and_a_screen_reader_hears_the_answer(page: PageProcess) -> None:
    with shared_browser(PHONE) as driver:
        open_page(driver, page, Role.VIEW, "guest", "twin")
        wait_for(lambda: driver.find_elements(By.CSS_SELECTOR, CARD))
        card = driver.find_element(By.CSS_SELECTOR, CARD)
        ask = card.find_element(By.TAG_NAME, "button")
        driver.execute_script("arguments[0].click()", ask)
        wait_for(lambda: "reach_c: a number is needed" in card.text)
        values = {"Heater [W]": "150", "Target [°C]": "35", "Room [°C]": "20"}
        for label in card.find_elements(By.TAG_NAME, "label"):
            if value := values.get(label.text):
                label.find_element(By.TAG_NAME, "input").send_keys(value)
        driver.execute_script("arguments[0].click()", ask)
        # An answer of before, or one that has to wait for the allowance.
        wait_for(lambda: card.text.count("With the change: Yes: 35 °C") or "try again soon" in card.text)
        if "try again soon" in card.text:
            time.sleep(questions.EVERY_S)
            driver.execute_script("arguments[0].click()", ask)
        wait_for(
            lambda: (
                "With the change: Yes: 35 °C takes"
                in card.find_element(By.CSS_SELECTOR, "[role=status]").text
            )
        )
        assert driver.execute_script("return document.documentElement.scrollWidth") <= PHONE[0]
        found = Axe().run(driver)["violations"]
        assert [each["id"] for each in found if each["impact"] in ("serious", "critical")] == []


# The line of those who ask, without processes.


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """Commands that were run; each gives its words as the answer."""
    commands: list[tuple[str, ...]] = []

    async def run(command: tuple[str, ...]) -> Json:
        commands.append(command)
        await asyncio.sleep(0)
        return {"ok": True, "words": command}

    monkeypatch.setattr(questions, "run_command", run)
    return commands


def test_equal_questions_are_computed_once(computed: list[tuple[str, ...]]) -> None:
    async def crowd() -> list[Json]:
        asked = TwinQuestions("/etc/rig.yaml")
        return await asyncio.gather(*(asked.ask(("--reach=35",)) for _ in range(4)))

    assert len(asyncio.run(crowd())) == 4
    assert computed == [(*questions.COMMAND, "--config", "/etc/rig.yaml", "--reach=35")]


def test_new_questions_have_an_allowance_and_old_ones_have_none(computed: list[tuple[str, ...]]) -> None:
    async def many() -> None:
        asked = TwinQuestions("")
        for k in range(BURST):
            await asked.ask((f"--reach={k}",))
        with pytest.raises(NotAllowed, match="one new question in"):
            await asked.ask(("--reach=new",))
        await asked.ask(("--reach=0",))

    asyncio.run(many())
    assert len(computed) == BURST


def test_few_wait_and_few_answers_are_kept(
    computed: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(questions, "BURST", 1000)

    async def many() -> tuple[list[object], int]:
        asked = TwinQuestions("")
        together = await asyncio.gather(*(asked.ask((f"{k}",)) for k in range(20)), return_exceptions=True)
        for k in range(100, 100 + 2 * KEEP_MAX):
            await asked.ask((f"{k}",))
        return list(together), len(asked.answers)

    together, count = asyncio.run(many())
    assert sum(isinstance(each, NotAllowed) for each in together) == 20 - questions.WAITING_MAX
    assert count == KEEP_MAX


def test_equal_numbers_make_equal_options() -> None:
    first = options({"reach_c": "35", "room_c": "20.04", "heater_w": "150.0"})
    assert first == options({"room_c": "2.0e1", "heater_w": "150", "reach_c": "35.01"})
    assert first == ("--heater-w=150", "--reach=35", "--room=20")
    assert "--room=-3.5" in options({"reach_c": "5", "room_c": "-3.5"})


# The process.


def python(code: str) -> tuple[str, ...]:
    return (sys.executable, "-c", code)


def test_a_process_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(questions, "ANSWER_MAX_S", 0.5)
    place = tmp_path / "pid"
    code = f"import os, time; open({str(place)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    with pytest.raises(RequestError, match="no answer within"):
        asyncio.run(run_command(python(code)))
    assert not place.exists() or not Path(f"/proc/{place.read_text()}").exists()


@pytest.mark.parametrize(
    "code", ["print('no JSON')", "import os; os.kill(os.getpid(), 9)", "print('{\"ok\":' + 'x' * 99)"]
)
def test_a_process_that_fails_says_so(code: str) -> None:
    with pytest.raises(RequestError, match="ended by itself"):
        asyncio.run(run_command(python(code)))


def test_a_refusal_is_passed_on_in_one_line() -> None:
    code = "import sys; print('usage: x\\ngreenhouse what-if: walls: none', file=sys.stderr); sys.exit(2)"
    assert asyncio.run(run_command(python(code))) == {"ok": False, "error": "walls: none"}


def test_the_process_stands_back_for_the_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    code = """
import json, os
adjusted = int(open("/proc/self/oom_score_adj").read())
print(json.dumps({"nice": os.nice(0), "oom": adjusted, "threads": os.environ["OPENBLAS_NUM_THREADS"]}))
"""
    found = asyncio.run(run_command(python(code)))
    assert found == {"nice": os.nice(0) + questions.NICE, "oom": 1000, "threads": "1"}
