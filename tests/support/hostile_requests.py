"""Requests of strangers, of other sites and of guests, as bytes.

A page refuses each of them, closes the connection in time, and the rig and its history stay as they are.
"""

import json
import re
import socket
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from typing import Any

from edge.page.access import DAY_S, NEEDS, Access, Role
from edge.page.cookie import COOKIE

PATIENCE_S = 30.0  # for the end of a connection
DRIP_S = 0.5  # between two bytes of a slow request
CLOSED = 0  # in place of a status: hung up without an answer
SCRIPT = "<img src=x onerror=alert(1)>"
ORDER = {"do": "set_mode", "mode": "off"}
WRITES: tuple[tuple[str, str, Any], ...] = (
    ("POST", "/api/order", ORDER),
    ("POST", "/api/stop", {}),
    ("POST", "/api/links", {"role": "admin", "name": "eve", "days": 1}),
    ("POST", "/api/session", {"name": "eve", "password": "correct horse"}),
    ("DELETE", "/api/session", {}),
    ("DELETE", "/api/sessions/1", {}),
    ("POST", "/api/events/acknowledge", {"seq": 1, "number": 0}),
)
READS = (
    "me", "view", "stream", "course?from_utc=0&to_utc=1", "events", "span", "why?at_utc=1", "sessions",
    "models", "diagnoses", "diagnoses/x", "diagnoses/x/report",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class HostileRequest:
    """Bytes for one connection.

    answers : status codes that refuse it
    is_slow : one more byte follows after the other, until the page hangs up
    """

    kind: str
    data: bytes
    answers: frozenset[int]
    is_slow: bool = False


@dataclass(frozen=True, slots=True)
class Victim:
    """A page at a port of this machine, and sessions of an administrator and of a guest to abuse."""

    port: int
    admin: str
    guest: str

    @classmethod
    def of(cls, port: int, access: Access) -> "Victim":
        """Return the page with new sessions."""
        begun = (
            access.enter(access.make_link(role, role.word, DAY_S), "") for role in (Role.ADMIN, Role.VIEW)
        )
        admin, guest = (found[0] for found in begun if found is not None)
        return cls(port, admin, guest)

    @property
    def host(self) -> str:
        """The name that a browser sends."""
        return f"127.0.0.1:{self.port}"

    def request(
        self, method: str, path: str, body: bytes | None = None, secret: str = "", **headers: str | None
    ) -> bytes:
        """Return a request as the page's own; `headers` replace its own ones, None leaves one out."""
        own: dict[str, str | None] = {"host": self.host, "connection": "close"}
        if secret:
            own["cookie"] = f"{COOKIE}={secret}"
        if body is not None:
            own |= {"origin": f"http://{self.host}", "sec-fetch-site": "same-origin"}
            own |= {"content-type": "application/json", "content-length": str(len(body))}
        own |= {name.replace("_", "-"): value for name, value in headers.items()}
        lines = (f"{name}: {value}\r\n" for name, value in own.items() if value is not None)
        return f"{method} {path} HTTP/1.1\r\n{''.join(lines)}\r\n".encode("latin-1") + (body or b"")

    def change(self, method: str, path: str, values: Any, secret: str, **headers: str | None) -> bytes:
        """Return a change as JSON."""
        return self.request(method, path, json.dumps(values).encode(), secret, **headers)


def hostile_requests(victim: Victim) -> list[HostileRequest]:
    """Return all of them; no two are alike."""
    return [request for maker in _MAKERS for request in maker(victim)]


def send(port: int, request: HostileRequest) -> tuple[int, bytes]:
    """Return the status of the answer, CLOSED without one, and all that was answered. Errors: TimeoutError"""
    deadline_s, answer = time.monotonic() + PATIENCE_S, b""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as connection:
        with suppress(ConnectionError):  # it may be refused before all of it is sent
            connection.sendall(request.data)
        connection.settimeout(DRIP_S if request.is_slow else PATIENCE_S)
        while time.monotonic() < deadline_s:
            try:
                part = connection.recv(65536)
            except TimeoutError:
                with suppress(ConnectionError):
                    connection.sendall(b"a")
                continue
            except ConnectionError:
                part = b""
            if not part:
                return _status(answer), answer
            answer += part
    raise TimeoutError(f"{request.kind}: the connection stayed open: {request.data[:80]!r}, {answer[:80]!r}")


def send_all(port: int, requests: list[HostileRequest], at_once: int) -> list[tuple[int, bytes]]:
    """Return what `send` returns of each, so many at once; the slow ones begin first."""
    with ThreadPoolExecutor(at_once) as pool:
        under_way = {
            request.data: pool.submit(send, port, request)
            for request in sorted(requests, key=lambda request: not request.is_slow)
        }
        return [under_way[request.data].result() for request in requests]


def _status(answer: bytes) -> int:
    found = re.match(rb"HTTP/1\.1 (\d{3}) ", answer)
    return int(found[1]) if found else CLOSED


def _foreign_sites(victim: Victim) -> Iterator[HostileRequest]:
    """Yield changes that another site makes the browser of an administrator send."""
    base = f"http://{victim.host}"
    variants: tuple[Mapping[str, str | None], ...] = (
        *({"origin": origin} for origin in ("http://evil.example", "null", "", f"{base}.evil.example")),
        *({"origin": origin} for origin in ("http://127.0.0.1:1", f"{base}/", f"{base}@evil.example", None)),
        {"sec_fetch_site": "cross-site"},
        {"sec_fetch_site": "same-site"},
        *({"content_type": kind} for kind in ("text/plain", "application/x-www-form-urlencoded", None)),
        {"content_type": "multipart/form-data; boundary=x"},
        {"content_type": "text/plain; application/json"},
    )
    for (method, path, values), headers in product(WRITES, variants):
        data = victim.change(method, path, values, victim.admin, **headers)
        yield HostileRequest("another site", data, frozenset({403, 415}))
    for path in READS:
        data = victim.request("GET", f"/api/{path}", None, victim.admin, sec_fetch_site="cross-site")
        yield HostileRequest("another site", data, frozenset({403}))


def _foreign_names(victim: Victim) -> Iterator[HostileRequest]:
    """Names of others that lead to this machine (DNS rebinding)."""
    names = (
        *("evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80", "evil.example:8420", "evil"),
        *("0x7f.1", "127.1", "2130706433", "[::1", "[::1].evil.example", "localhost@evil.example", "*"),
        *(
            "127.0.0.1, evil.example",
            "evil.example, 127.0.0.1",
            "localhost%00",
            "xn--lcalhost-54a",
            "..",
            ":80",
        ),
        *("local host", "localhost/", "http://localhost", "127.0.0.1.", "127.0.0.256", "a" * 5000),
    )
    for name, (method, path, values) in product(names, (("GET", "/api/view", None), WRITES[0])):
        if values is None:
            data = victim.request(method, path, None, victim.admin, host=name)
        else:
            data = victim.change(method, path, values, victim.admin, host=name, origin=f"http://{name}")
        yield HostileRequest("another name", data, frozenset({400, 421}))
    two = victim.request("GET", "/api/view", None, victim.admin).replace(
        b"\r\n", b"\r\nhost: evil.example\r\n", 1
    )
    yield HostileRequest("another name", two, frozenset({400, 421}))
    none = victim.request("GET", "/api/view", None, victim.admin, host=None)
    yield HostileRequest("another name", none, frozenset({400, 421}))
    target = victim.request("GET", "http://evil.example/api/view", None, victim.admin)
    yield HostileRequest("another name", target, frozenset({400, 404, 421}))


def _methods(victim: Victim) -> Iterator[HostileRequest]:
    names = ("PUT", "PATCH", "OPTIONS", "TRACE", "CONNECT", "PROPFIND", "get", "DEBUG", "X" * 300)
    for method, path in product(names, ("/", "/api/order", "/api/session")):
        data = victim.change(method, path, ORDER, victim.admin)
        yield HostileRequest("method", data, frozenset({400, 404, 405}))
    for method, path in (
        ("GET", "/api/order"),
        ("GET", "/api/stop"),
        ("GET", "/api/links"),
        ("HEAD", "/api/order"),
    ):
        data = victim.request(method, f"{path}?do=emergency_stop", None, victim.admin)
        yield HostileRequest("method", data, frozenset({404, 405}))
    override = victim.request("GET", "/api/stop", None, victim.admin, x_http_method_override="POST")
    yield HostileRequest("method", override, frozenset({404, 405}))


def _paths(victim: Victim) -> Iterator[HostileRequest]:
    """Paths out of the folder of static files."""
    climbs = ("..", "%2e%2e", "..%2f..", "....//..", "..;", ".%2e", "%252e%252e", "..%5c..", "%c0%ae%c0%ae")
    files = ("access.py", "page/app.py", "etc/passwd", "page.db")
    for climb, file in product(climbs, files):
        data = victim.request("GET", f"/{climb}/{file}", None, victim.admin)
        yield HostileRequest("path", data, frozenset({400, 404}))
    for path in (
        *(
            "/etc/passwd",
            "//etc/passwd",
            "///etc/passwd",
            "/static/../../../etc/passwd",
            "/%00",
            "/index.html%00.js",
        ),
        *(
            "/vendor/../../app.py",
            "/vendor/%2e%2e%2f%2e%2e%2fserver.py",
            "/vendor",
            "/vendor/",
            "/.",
            "/..",
            "/%2f",
        ),
        *(
            "/vendor/..%00/app.py",
            "/C:/windows/win.ini",
            "/~root",
            "/.git/config",
            "/.env",
            "/proc/self/environ",
        ),
        *("/api", "/api/", "/api/../api/sessions/..", "/API/ME", "/api/me/", "/api//me", "/api/sessions/-1"),
    ):
        data = victim.request("GET", path, None, victim.admin)
        yield HostileRequest("path", data, frozenset({307, 400, 404, 405}))


def _filters(victim: Victim) -> Iterator[HostileRequest]:
    """Yield SQL and nonsense in place of numbers and known words."""
    poisons = (
        *("alarm'%20OR%201=1%20--", "1;DROP%20TABLE%20ticks", "0)%20OR%201=1%20--", "1e999", "nan", "-inf"),
        *(
            "1%20UNION%20SELECT%20secret%20FROM%20sessions",
            "%00",
            "",
            "0x10",
            "1_0_0_0_0_0_0_0_0_0_0_0_0_0",
            "9" * 400,
        ),
        *("%F0%9F%92%A5", "[]", "true", "1%27", "%22", "$(id)", "%0d%0aset-cookie:a=b"),
    )
    for poison in poisons:
        for path in (
            f"events?least={poison}",
            f"events?before_utc={poison}",
            f"events?most={poison}",
            f"course?from_utc={poison}&to_utc=5",
            f"course?from_utc=0&to_utc=5&points={poison}",
            f"why?at_utc={poison}",
        ):
            data = victim.request("GET", f"/api/{path}", None, victim.admin)
            yield HostileRequest("filter", data, frozenset({400}))


def _scripts(victim: Victim) -> Iterator[HostileRequest]:
    """Texts that would be scripts if they were ever taken for HTML."""
    quoted = SCRIPT.replace(" ", "%20").replace("<", "%3C").replace(">", "%3E")
    for path in (f"/{quoted}", f"/api/{quoted}", f"/vendor/{quoted}.js"):
        data = victim.request("GET", path, None, victim.admin, user_agent=SCRIPT, referer=SCRIPT)
        yield HostileRequest("script", data, frozenset({404}))
    for order in (
        {"do": SCRIPT},
        {"do": "set_mode", "mode": SCRIPT},
        {"do": "set_controller", "name": SCRIPT},
        {"do": "set_fan_mode", "mode": SCRIPT},
        {"do": "set_reference", "reference_c": SCRIPT},
        {"do": "maintenance", "minutes": SCRIPT},
        {"do": "confirm", "id": SCRIPT},
        {"do": "bundle", "action": SCRIPT},
    ):
        data = victim.change("POST", "/api/order", order, victim.admin)
        yield HostileRequest("script", data, frozenset({400, 504}))
    data = victim.change("POST", "/api/session", {"link": SCRIPT}, "", user_agent=SCRIPT)
    yield HostileRequest("script", data, frozenset({401}))
    data = victim.change("POST", "/api/links", {"role": SCRIPT, "name": SCRIPT, "days": 1}, victim.admin)
    yield HostileRequest("script", data, frozenset({400}))


def _no_orders(victim: Victim) -> Iterator[HostileRequest]:
    """Yield orders of an administrator that make no sense."""
    no_words: tuple[Any, ...] = ("steer", "resend", "commission", "status", "why", "SET_MODE", "", None, 1)
    no_temps: tuple[Any, ...] = (1e308, -1e9, True, [], {}, "30", 10**300)
    no_modes: tuple[Any, ...] = (None, 0, ["off"], "off\u0000", "\ud800", "OFF", "a" * 9999)
    no_duties: tuple[Any, ...] = (2, -1, "1", [1])
    no_minutes: tuple[Any, ...] = (-1, 1e12, "60", [])
    orders: tuple[dict[str, Any], ...] = (
        *({"do": word} for word in (*no_words, ["set_mode"], {"set_mode": 1})),
        *({"do": "set_reference", "reference_c": value} for value in no_temps),
        *({"do": "set_manual", "heater_duty": value} for value in no_duties),
        *({"do": "maintenance", "minutes": value} for value in no_minutes),
        *({"do": "set_mode", "mode": value} for value in no_modes),
        *({}, {"mode": "off"}, {"do": "set_mode"}),
        {"do": "bundle", "action": "install", "path": "/etc/shadow"},
        {"do": "bundle", "action": "../../etc"},
    )
    for order in orders:
        data = victim.change("POST", "/api/order", order, victim.admin)
        yield HostileRequest("no order", data, frozenset({400, 504}))


def _bombs(victim: Victim) -> Iterator[HostileRequest]:
    """JSON that costs a careless reader its stack, its memory or its time."""
    for body in (
        *(
            b"",
            b"[]",
            b"null",
            b"{",
            b"}",
            b'"do"',
            b"\xff\xfe",
            b"\xef\xbb\xbf{}",
            b'{"do": NaN}',
            b'{"do": Infinity}',
        ),
        *(
            b"[" * 60_000,
            b'{"a":' * 12_000,
            b'{"do":' + b"[" * 60_000,
            b"9" * 60_000,
            b'{"do": ' + b"9" * 60_000 + b"}",
        ),
        *(
            b'{"do": "' + b"\\u0041" * 10_000 + b'"}',
            b'{"do": "' + b"\\" * 60_000,
            b"{" + b'"a":1,' * 9_000 + b'"b":1}',
        ),
        *(b'{"do": 1e99999}', b'{"do": "set_mode", "do": "steer"}', b'{"do": "\x00"}', b"{'do': 'set_mode'}"),
        *(
            b'{"do": {"a": 1}}',
            b'{"do": "' + b"x" * 60_000 + b'"}',
            b" " * 65_000,
            b"<xml/>",
            b"do=set_mode&mode=off",
        ),
    ):
        data = victim.request("POST", "/api/order", body, victim.admin)
        yield HostileRequest("JSON bomb", data, frozenset({400}))


def _large_bodies(victim: Victim) -> Iterator[HostileRequest]:
    chunked: dict[str, str | None] = {"transfer_encoding": "chunked", "content_length": None}
    for path in ("/api/order", "/api/session", "/api/links", "/api/nothing"):
        for size in (65_537, 300_000, 3_000_000):
            data = victim.request("POST", path, b" " * size, victim.admin)
            yield HostileRequest("large body", data, frozenset({413, CLOSED}))
        for size, chunks in ((1, 70_000), (4096, 100), (100_000, 2)):
            body = (f"{size:x}\r\n".encode() + b" " * size + b"\r\n") * chunks + b"0\r\n\r\n"
            data = victim.request("POST", path, body, victim.admin, **chunked)
            yield HostileRequest("large body", data, frozenset({413, CLOSED}))


def _broken_http(victim: Victim) -> Iterator[HostileRequest]:
    own = f"host: {victim.host}\r\ncookie: {COOKIE}={victim.admin}\r\n".encode()
    post = b"POST /api/stop HTTP/1.1\r\n" + own + f"origin: http://{victim.host}\r\n".encode()
    post += b"content-type: application/json\r\n"
    for data in (
        *(
            b"\r\n\r\n",
            b"\n" * 50,
            b"\x00" * 100,
            b"\xff" * 100 + b"\r\n\r\n",
            b"GET\r\n\r\n",
            b"GET /\r\n\r\n",
            b"GET / HTTP/9.9\r\nconnection: close\r\n\r\n",
        ),
        *(
            b"GET / HTTP/0.9\r\n\r\n",
            b"GET /  HTTP/1.1\r\n\r\n",
            b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        ),
        *(
            b"SSH-2.0-OpenSSH_9.2\r\n\r\n",
            b"EHLO evil.example\r\n\r\n",
            b"*1\r\n$4\r\nPING\r\n\r\n",
            b"\x16\x03\x01\x02\x00\x01\r\n\r\n",
        ),
        *(
            b"GET / HTTP/1.1\r\nhost : x\r\n\r\n",
            b"GET / HTTP/1.1\r\n: x\r\n\r\n",
            b"GET / HTTP/1.1\r\nhost\r\n\r\n",
        ),
        *(
            b"GET / HTTP/1.1\r\n folded: x\r\n\r\n",
            b"GET / HTTP/1.1\r\nhost: a\x00b\r\n\r\n",
            b"GET / HTTP/1.1\rhost: x\r\r\n\r\n",
        ),
        b"GET /api/\xc3\xa9 HTTP/1.1\r\n" + own + b"\r\n",
        b"GET http://[::1 HTTP/1.1\r\n\r\n",
        # Smuggling: two lengths, or a length and chunks, leave open where a request ends.
        post + b"content-length: 2\r\ncontent-length: 3\r\n\r\n{}",
        post + b"content-length: 2, 3\r\n\r\n{}",
        post + b"content-length: -1\r\n\r\n{}",
        post + b"content-length: +2\r\n\r\n{}",
        post + b"content-length: 0x2\r\n\r\n{}",
        post + b"content-length: " + b"9" * 30 + b"\r\n\r\n{}",
        post + b"transfer-encoding: identity\r\n\r\n{}",
        post + b"transfer-encoding: gzip, chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n",
        post + b"transfer-encoding: chunked, chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n",
        post + b"transfer-encoding: \x0bchunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n",
        post + b"transfer-encoding: chunked\r\n\r\nzz\r\n{}\r\n0\r\n\r\n",
        post + b"transfer-encoding: chunked\r\n\r\n-2\r\n{}\r\n0\r\n\r\n",
        post + b"transfer-encoding: chunked\r\n\r\n" + b"f" * 40 + b"\r\n{}\r\n0\r\n\r\n",
    ):
        yield HostileRequest("broken HTTP", data, frozenset({400, 404, 405, 413, 421, 501, CLOSED}))


def _large_heads(victim: Victim) -> Iterator[HostileRequest]:
    refused = frozenset({400, 401, 404, 421, 431, CLOSED})
    for size in (20_000, 70_000, 1_000_000):
        yield HostileRequest("large head", victim.request("GET", f"/{'a' * size}"), refused)
        yield HostileRequest("large head", victim.request("GET", "/api/me", x_filler="a" * size), refused)
        cookies = "; ".join(f"a{k}=b" for k in range(size // 6))
        yield HostileRequest("large head", victim.request("GET", "/api/me", cookie=cookies), refused)
        many: dict[str, str | None] = {f"x-{k}": "" for k in range(size // 8)}
        yield HostileRequest("large head", victim.request("GET", "/api/me", None, "", **many), refused)
        yield HostileRequest("large head", b"a" * size + b"\r\n\r\n", refused)


def _without_a_session(victim: Victim) -> Iterator[HostileRequest]:
    for path in READS:
        yield HostileRequest("no session", victim.request("GET", f"/api/{path}"), frozenset({401}))
    for method, path, values in WRITES:
        if path != "/api/session" or method == "DELETE":
            yield HostileRequest("no session", victim.change(method, path, values, ""), frozenset({401}))
    for cookie in (
        *("", "guess", "0" * 43, "' OR 1=1 --", "%00", "None", victim.admin[:-1], victim.admin.swapcase()),
        *(f" {victim.admin}a", "é", "=", ";", '"', "\\", "a" * 4000),
    ):
        data = victim.request("GET", "/api/sessions", None, "", cookie=f"{COOKIE}={cookie}")
        yield HostileRequest("no session", data, frozenset({400, 401}))
    for scheme in (
        "Bearer ",
        "Bearer guess",
        f"Basic {victim.admin}",
        f"bearer {victim.admin}",
        "Bearer ' OR ''='",
    ):
        data = victim.change("POST", "/api/stop", {}, "", authorization=scheme)
        yield HostileRequest("no session", data, frozenset({401}))


def _of_a_guest(victim: Victim) -> Iterator[HostileRequest]:
    """Yield what a link for guests does not allow."""
    for kind in NEEDS:
        if kind != "emergency_stop":
            data = victim.change(
                "POST", "/api/order", {"do": kind, "mode": "off", "by": "root"}, victim.guest
            )
            yield HostileRequest("guest", data, frozenset({403}))
    for method, path, values in WRITES[2:]:
        if path != "/api/session":
            yield HostileRequest("guest", victim.change(method, path, values, victim.guest), frozenset({403}))
    yield HostileRequest(
        "guest", victim.request("GET", "/api/sessions", None, victim.guest), frozenset({403})
    )
    for role in ("admin", "operate", "view"):
        data = victim.change(
            "POST", "/api/links", {"role": role, "name": "x", "days": 1}, victim.guest, role="admin"
        )
        yield HostileRequest("guest", data, frozenset({403}))


def _guesses(victim: Victim) -> Iterator[HostileRequest]:
    """Names and passwords. Nobody of these names has a password, or has another one."""
    names = ("eve", "admin", "root", "Ann", "' OR 1=1 --")
    passwords = ("password", "12345678", "' OR ''='", "\x00", "a" * 200, "correct horse")
    for name, password in product(names, passwords):
        data = victim.change("POST", "/api/session", {"name": name, "password": password}, "")
        yield HostileRequest("guess", data, frozenset({401, 429}))
    for values in (
        {"name": "eve"},
        {"name": ["eve"], "password": 1},
        {"name": "eve", "password": "a" * 9999},
        {"link": 1},
    ):
        yield HostileRequest("guess", victim.change("POST", "/api/session", values, ""), frozenset({400}))
    for link in ("", "a", "' OR 1=1 --", victim.admin):
        data = victim.change("POST", "/api/session", {"link": link}, "")
        yield HostileRequest("guess", data, frozenset({400, 401}))


def _slow(victim: Victim) -> Iterator[HostileRequest]:
    """Heads and bodies that never end; each would keep a place that others need."""
    head = victim.request("GET", "/api/me", connection="keep-alive")
    silent = frozenset({CLOSED, 400})
    for begun in (b"", b"G", head[:30], head[:-2] + b"x-slow: ", b"\r\n"):
        yield HostileRequest("slow head", begun, silent, is_slow=True)
    # A second head, after a request that was answered.
    yield HostileRequest("slow head", head + b"GET / HT", frozenset({401}), is_slow=True)
    for path in ("/api/order", "/api/session", "/api/nothing"):
        data = victim.request("POST", path, b"{", victim.admin, content_length="60000")
        yield HostileRequest("slow body", data, frozenset({413}), is_slow=True)
    chunked = victim.request(
        "POST", "/api/order", b"2\r\n{}\r\n", "", transfer_encoding="chunked", content_length=None
    )
    yield HostileRequest("slow body", chunked + b"9999\r\n", frozenset({413}), is_slow=True)
    # A GET has no body here: it is answered, and its connection is not kept for the rest.
    data = victim.request("GET", "/api/me", b"{", connection="keep-alive", content_length="60000")
    yield HostileRequest("slow body", data, frozenset({401}), is_slow=True)


_MAKERS = (
    *(_foreign_sites, _foreign_names, _methods, _paths, _filters, _scripts, _no_orders, _bombs),
    *(_large_bodies, _broken_http, _large_heads, _without_a_session, _of_a_guest, _guesses, _slow),
)
KINDS = tuple(dict.fromkeys(request.kind for request in hostile_requests(Victim(1, "a" * 43, "b" * 43))))
