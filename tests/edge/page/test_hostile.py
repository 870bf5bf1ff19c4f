"""Requests of strangers: other sites and names, paths, SQL, scripts, huge and slow bodies, open streams."""

import contextlib
import json
import sqlite3
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest
from history_records import HandClock, History, eventful_tick

from bench.default_daemon import memory_of
from edge.page.access import DAY_S, Role
from edge.page.password_tries import TRIES_OF_ALL
from edge.storage import Session, Storage
from tests.support.hostile_requests import (
    KINDS,
    ORDER,
    SCRIPT,
    HostileRequest,
    Victim,
    hostile_requests,
    send_all,
)
from tests.support.page_process import Client, PageProcess, page_of

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page() -> Iterator[PageProcess]:
    """A page without a daemon; its history has one tick with events."""
    with tempfile.TemporaryDirectory(prefix="gh-") as name, page_of(Path(name)) as running:
        storage = Storage(History.at(Path(name) / "history.db"), HandClock(0.0), Session())
        storage.open()
        storage.write(eventful_tick(1))
        assert storage.close(10.0)
        yield running


@pytest.fixture(scope="module")
def admin(page: PageProcess) -> Client:
    return page.client()


@dataclass(frozen=True)
class Attack:
    """Each hostile request with its status and answer, and what lay on the disk before and after."""

    answers: list[tuple[HostileRequest, int, bytes]]
    before: Mapping[str, object]
    after: Mapping[str, object]


@pytest.fixture(scope="module")
def attack(page: PageProcess) -> Attack:
    """All hostile requests, many at once."""
    page.access.set_password("eve", Role.ADMIN, "the right one")
    requests = hostile_requests(Victim.of(page.port, page.access))
    before = kept(page)
    found = send_all(page.port, requests, at_once=32)
    return Attack(
        [(request, *each) for request, each in zip(requests, found, strict=True)], before, kept(page)
    )


def kept(page: PageProcess) -> dict[str, object]:
    """Return all that the page and its rig have on the disk."""
    folder = page.config.parent
    tables = ("people", "facts", "acknowledged", "links", "sessions")
    with closing(sqlite3.connect(page.access.path)) as db:
        rows = {name: db.execute(f"SELECT * FROM {name}").fetchall() for name in tables}
    files = {path.name for path in folder.rglob("*") if path.suffix != ".db-journal"}
    return {**rows, "files": files, "history": (folder / "history.db").read_bytes()}


def test_there_are_three_hundred_hostile_requests_at_least(attack: Attack) -> None:
    assert len({request.data for request, _, _ in attack.answers}) == len(attack.answers) >= 300


@pytest.mark.parametrize("kind", KINDS)
def test_hostile_requests_are_refused(attack: Attack, kind: str) -> None:
    answers = [
        (request, status, answer) for request, status, answer in attack.answers if request.kind == kind
    ]
    assert answers
    for request, status, answer in answers:
        assert status in request.answers, (request.data[:200], status, answer[-200:])
        for leak in (b"text/html", b"root:", b"import ", b"Traceback", b"set-cookie"):
            assert leak not in answer, (request.data[:200], answer)


def test_hostile_requests_change_nothing_and_fill_no_log(page: PageProcess, attack: Attack) -> None:
    assert attack.after == attack.before
    assert page.log == ""


def test_another_sites_reading_is_refused_and_its_link_is_not(admin: Client) -> None:
    assert admin.get("/api/sessions", **{"sec-fetch-site": "cross-site"}).status_code == 403
    assert admin.get("/", **{"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}).ok
    answer = admin.get("/api/me", origin="http://evil.example")
    assert "access-control-allow-origin" not in answer.headers


def test_a_viewer_may_look_and_stop_and_nothing_else(page: PageProcess) -> None:
    viewer = page.client(Role.VIEW, "guest")
    for values in (ORDER, {"do": "release_emergency_stop"}, {"do": "bundle", "action": "list"}):
        assert viewer.post("/api/order", values).status_code == 403
    assert viewer.post("/api/links", {"role": "admin", "name": "x", "days": 1}).status_code == 403
    assert viewer.get("/api/sessions").status_code == 403
    assert viewer.send("DELETE", "/api/sessions/1").status_code == 403
    assert viewer.post("/api/events/acknowledge", {"seq": 1, "number": 0}).status_code == 403
    assert viewer.post("/api/order", {"do": "emergency_stop"}).json()["waits"]


def test_one_who_operates_ends_a_link_to_view_and_nothing_more(page: PageProcess, admin: Client) -> None:
    operator, guest = page.client(Role.OPERATE), Client(page.base)
    link = page.access.make_link(Role.VIEW, "class", DAY_S, None)
    assert guest.post("/api/session", {"link": link}).ok
    found = operator.get("/api/sessions").json()
    assert {row["role"] for kind in ("sessions", "links", "people") for row in found[kind]} == {"view"}
    [number] = [row["link"] for row in found["links"] if row["name"] == "class"]
    above = next(
        row["session"] for row in admin.get("/api/sessions").json()["sessions"] if row["role"] == "admin"
    )
    assert operator.send("DELETE", f"/api/sessions/{above}").status_code == 403
    assert operator.send("DELETE", f"/api/links/{number}").ok
    assert guest.get("/api/me").status_code == 401
    assert guest.post("/api/session", {"link": link}).status_code == 401
    for path in ("links/0", f"sessions/{9**40}", "sessions/-1", "sessions/x", "people/%00", "facts/network"):
        assert operator.send("DELETE", f"/api/{path}").status_code in (400, 404), path


def test_guessing_is_slowed_down(page: PageProcess) -> None:
    page.access.set_password("eve", Role.VIEW, "correct horse")
    nobody = page.client(None)
    codes = [
        nobody.post("/api/session", {"name": "eve", "password": f"guess {k}"}).status_code for k in range(8)
    ]
    assert codes[-1] == 429
    assert set(codes) <= {401, 429}
    assert nobody.post("/api/session", {"name": "eve", "password": "correct horse"}).status_code == 429


def test_invented_names_lock_nobody_out_and_their_answers_are_those_of_known_ones(page: PageProcess) -> None:
    page.access.set_password("ann", Role.VIEW, "correct horse")
    nobody = page.client(None)
    wrong = nobody.post("/api/session", {"name": "ann", "password": "battery staple"})
    found = [
        nobody.post("/api/session", {"name": f"nobody {k}", "password": "guess"})
        for k in range(TRIES_OF_ALL + 10)
    ]
    assert {(each.status_code, each.text) for each in found} == {(401, wrong.text)}
    assert nobody.post("/api/session", {"name": "ann", "password": "correct horse"}).ok


def test_what_stands_in_a_text_reaches_the_browser_as_text(page: PageProcess, admin: Client) -> None:
    """The page writes texts by `textContent`; here: nothing is served as HTML that came from elsewhere."""
    for path in ("/api/events", "/api/me", "/api/view", f"/api/{SCRIPT}"):
        answer = admin.get(path)
        assert "html" not in answer.headers.get("content-type", "")
        assert answer.headers["content-security-policy"].startswith("default-src 'self';")
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "strict-transport-security" not in answer.headers
        behind_tls = admin.get(path, **{"x-forwarded-proto": "https"})
        assert behind_tls.headers["strict-transport-security"] == "max-age=2592000"


def test_two_hundred_streams_leave_the_page_to_the_others(page: PageProcess) -> None:
    link = page.access.make_link(Role.VIEW, "crowd", DAY_S, None)
    crowd = [Client(page.base) for _ in range(20)]
    page_streams = []
    with contextlib.ExitStack() as stack:
        for client in crowd:
            begun = page.access.enter(link, "crowd")
            assert begun is not None
            client.session.cookies.set("greenhouse_session", begun[0])
        for k in range(200):
            answer = crowd[k % 20].session.get(f"{page.base}/api/stream", stream=True, timeout=20)
            stack.callback(answer.close)
            page_streams.append(answer.status_code)
        assert set(page_streams) == {200}  # older ones end
        other = page.client(Role.VIEW, "other")
        stack.enter_context(other.session.get(f"{page.base}/api/stream", stream=True, timeout=20))
        assert other.view()["ok"]
        assert other.post("/api/stop").json()["ok"]
    assert page.process is not None
    assert memory_of(str(page.process.pid)).rss < 60.0


def test_a_link_for_once_is_used_once_and_an_ended_session_is_over(page: PageProcess) -> None:
    link = page.access.make_link(Role.OPERATE, "Bo", DAY_S)
    first = page.access.enter(link, "")
    assert first is not None
    assert page.access.enter(link, "") is None
    client = Client(page.base)
    client.session.cookies.set("greenhouse_session", first[0])
    assert client.get("/api/me").ok
    page.access.revoke("sessions", first[1].session)
    assert client.get("/api/me").status_code == 401


def test_the_sessions_secret_stands_nowhere_on_the_disk(page: PageProcess) -> None:
    link = page.access.make_link(Role.VIEW, "Cy", DAY_S)
    begun = page.access.enter(link, "")
    assert begun is not None
    kept = page.access.path.read_bytes()
    for secret in (link, begun[0]):
        assert secret.encode() not in kept
    assert json.dumps(page.access.sessions()).find(begun[0]) == -1
    assert page.access.path.stat().st_mode & 0o077 == 0
