"""Requests of strangers: other sites and names, paths, SQL, scripts, huge and slow bodies, open streams."""

import contextlib
import json
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from history_records import HandClock, History, eventful_tick

from bench.support.page_process import Client, PageProcess, page_of
from edge.page.access import DAY_S, Role
from edge.storage import Session, Storage

pytestmark = pytest.mark.slow
SCRIPT = "<img src=x onerror=alert(1)>"


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


ORDER = {"do": "set_mode", "mode": "off"}


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": ""},
        {"origin": "http://127.0.0.1:1"},
        {"sec_fetch_site": "cross-site"},
        {"sec_fetch_site": "same-site"},
        {"content_type": "text/plain"},
        {"content_type": "application/x-www-form-urlencoded"},
        {"content_type": "multipart/form-data; boundary=x"},
        {"host": "evil.example"},
        {"host": "127.0.0.1.evil.example"},
        {"host": "localhost.evil.example:80"},
        {"host": ""},
    ],
)
def test_a_change_that_this_page_did_not_send_is_refused_with_a_session_too(admin, headers) -> None:
    for path, values in (
        ("/api/order", ORDER),
        ("/api/stop", {}),
        ("/api/links", {"role": "admin", "days": 1}),
    ):
        refused = admin.post(path, values, **headers)
        assert refused.status_code in (400, 403, 415, 421), (path, headers, refused.text)


def test_another_sites_reading_is_refused_and_its_link_is_not(admin: Client) -> None:
    assert admin.get("/api/sessions", **{"sec-fetch-site": "cross-site"}).status_code == 403
    assert admin.get("/", **{"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}).ok
    answer = admin.get("/api/me", origin="http://evil.example")
    assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize("method", ["PUT", "PATCH", "OPTIONS", "TRACE", "CONNECT"])
def test_other_methods_are_not_served(admin: Client, method: str) -> None:
    assert admin.send(method, "/api/me").status_code in (400, 404, 405)


@pytest.mark.parametrize(
    "path",
    ["/../access.py", "/..%2faccess.py", "/%2e%2e/app.py", "/vendor/../../app.py", "/....//app.py",
     "/etc/passwd", "//etc/passwd", "/static/../../../etc/passwd", "/%00",
     "/vendor/%2e%2e%2f%2e%2e%2fserver.py"],
)  # fmt: skip
def test_no_path_leads_out_of_the_folder(page: PageProcess, path: str) -> None:
    head = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n"
    answer = raw(page, head.encode())
    assert answer.split()[1] in (b"400", b"404"), answer[:200]
    assert b"root:" not in answer
    assert b"import " not in answer


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/api/events?least=alarm' OR 1=1 --", 400),
        ("/api/events?before_utc=1;DROP TABLE ticks", 400),
        ("/api/events?most=1e999", 400),
        ("/api/course?from_utc=0&to_utc=nan", 400),
        ("/api/course?from_utc=0) OR 1=1 --&to_utc=5", 400),
        ("/api/course?from_utc=5&to_utc=1", 503),
        ("/api/course", 400),
        ("/api/why?at_utc=now", 400),
    ],
)
def test_filters_take_numbers_and_known_words_alone(admin: Client, path: str, status: int) -> None:
    assert admin.get(path).status_code == status
    assert admin.get("/api/events").json()["events"]


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"[]",
        b"null",
        b"{",
        b"\xff\xfe",
        b'{"do": NaN}',
        b"[" * 60_000,
        b'{"do": {"a": 1}}',
        b'{"do": "steer"}',
    ],
)
def test_a_body_that_is_no_order_is_refused(page: PageProcess, admin: Client, body: bytes) -> None:
    headers = {"origin": page.base, "content-type": "application/json"}
    answer = admin.session.post(f"{page.base}/api/order", data=body, headers=headers, timeout=20)
    assert answer.status_code == 400
    assert answer.json()["ok"] is False


def test_a_body_is_bounded_in_length_and_in_time(page: PageProcess, admin: Client) -> None:
    headers = {"origin": page.base, "content-type": "application/json"}
    large = admin.session.post(f"{page.base}/api/order", data=b" " * 70_000, headers=headers, timeout=20)
    assert large.status_code == 413
    head = (
        "POST /api/session HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://127.0.0.1\r\n"
        "Content-Type: application/json\r\nContent-Length: 60000\r\n\r\n{"
    )
    begun_s = time.monotonic()
    assert b" 413 " in raw(page, head.encode())
    assert time.monotonic() - begun_s < 20.0


def test_a_connection_that_says_nothing_is_closed(page: PageProcess) -> None:
    assert raw(page, b"GET / HTTP/1.1\r\nHo") == b""


def test_a_viewer_may_look_and_stop_and_nothing_else(page: PageProcess) -> None:
    viewer = page.client(Role.VIEW, "guest")
    for values in (ORDER, {"do": "release_emergency_stop"}, {"do": "bundle", "action": "list"}):
        assert viewer.post("/api/order", values).status_code == 403
    assert viewer.post("/api/links", {"role": "admin", "name": "x", "days": 1}).status_code == 403
    assert viewer.get("/api/sessions").status_code == 403
    assert viewer.send("DELETE", "/api/sessions/1").status_code == 403
    assert viewer.post("/api/events/acknowledge", {"seq": 1, "number": 0}).status_code == 403
    assert viewer.post("/api/order", {"do": "emergency_stop"}).json()["waits"]


def test_without_a_session_there_is_nothing_but_the_door(page: PageProcess) -> None:
    nobody = page.client(None)
    for path in (
        "me",
        "view",
        "stream",
        "course?from_utc=0&to_utc=1",
        "events",
        "span",
        "why?at_utc=1",
        "sessions",
    ):
        assert nobody.get(f"/api/{path}").status_code == 401
    assert nobody.post("/api/stop").status_code == 401
    nobody.session.cookies.set("greenhouse_session", "guess")
    assert nobody.get("/api/me").status_code == 401


def test_guessing_is_slowed_down(page: PageProcess) -> None:
    page.access.set_password("eve", Role.VIEW, "correct horse")
    nobody = page.client(None)
    codes = [
        nobody.post("/api/session", {"name": "eve", "password": f"guess {k}"}).status_code for k in range(8)
    ]
    assert codes[-1] == 429
    assert set(codes) <= {401, 429}
    assert nobody.post("/api/session", {"name": "eve", "password": "correct horse"}).status_code == 429


def test_what_stands_in_a_text_reaches_the_browser_as_text(page: PageProcess, admin: Client) -> None:
    """The page writes texts by `textContent`; here: nothing is served as HTML that came from elsewhere."""
    for path in ("/api/events", "/api/me", "/api/view", f"/api/{SCRIPT}"):
        answer = admin.get(path)
        assert "html" not in answer.headers.get("content-type", "")
        assert answer.headers["content-security-policy"].startswith("default-src 'self';")
        assert answer.headers["x-content-type-options"] == "nosniff"


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
        assert page_streams.count(200) >= 40
        assert 503 in page_streams
        other = page.client(Role.VIEW, "other")
        assert other.view()["ok"]
        assert other.post("/api/stop").json()["ok"]
    memory = Path(f"/proc/{page.process.pid}/status").read_text() if page.process else ""
    used_kb = next(int(line.split()[1]) for line in memory.splitlines() if line.startswith("VmRSS"))
    assert used_kb < 60_000


def test_a_link_for_once_is_used_once_and_an_ended_session_is_over(page: PageProcess) -> None:
    link = page.access.make_link(Role.OPERATE, "Bo", DAY_S)
    first = page.access.enter(link, "")
    assert first is not None
    assert page.access.enter(link, "") is None
    client = Client(page.base)
    client.session.cookies.set("greenhouse_session", first[0])
    assert client.get("/api/me").ok
    page.access.revoke(first[1].session)
    assert client.get("/api/me").status_code == 401


def raw(page: PageProcess, data: bytes) -> bytes:
    """Return all that is answered to bytes as they are."""
    with socket.create_connection(("127.0.0.1", urlsplit(page.base).port or 0), timeout=25) as connection:
        connection.sendall(data)
        answer = b""
        with contextlib.suppress(ConnectionResetError):
            while part := connection.recv(65536):
                answer += part
                if b"\r\n\r\n" in answer and b"connection: close" not in answer.lower() and len(part) < 60000:
                    head, _, rest = answer.partition(b"\r\n\r\n")
                    if len(rest) >= _length(head):
                        break
        return answer


def _length(head: bytes) -> int:
    lengths = [
        line.split(b":")[1] for line in head.split(b"\r\n") if line.lower().startswith(b"content-length")
    ]
    return int(lengths[0]) if lengths else 0


def test_the_sessions_secret_stands_nowhere_on_the_disk(page: PageProcess) -> None:
    link = page.access.make_link(Role.VIEW, "Cy", DAY_S)
    begun = page.access.enter(link, "")
    assert begun is not None
    kept = page.access.path.read_bytes()
    for secret in (link, begun[0]):
        assert secret.encode() not in kept
    assert json.dumps(page.access.sessions()).find(begun[0]) == -1
    assert page.access.path.stat().st_mode & 0o077 == 0
