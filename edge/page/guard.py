"""Checks that every request passes before a route sees it: host, origin, size, time; and headers of answers.

Against DNS rebinding the host has to be an address, this machine's name or one of the settings: a name of an
attacker's leads to this machine, but the browser still sends that name. Against requests that another site
makes a browser send (CSRF), a change has to be JSON from a page of the same origin.
"""

import asyncio
import ipaddress
import re
import socket
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

BODY_MAX = 64 << 10  # bytes
HSTS_S = 30 * 86_400  # no longer: it holds for every port of the host, also where TLS is given up
BODY_MAX_S = 10.0  # for all of a body
METHODS = ("GET", "HEAD", "POST", "DELETE")
SAFE = ("GET", "HEAD")
_HOST = re.compile(r"(\[[^\[\]]+\]|[^\[\]:]+)(?::[0-9]{1,5})?")
HEADERS = {
    "content-security-policy": (
        "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    ),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}


class _TooLarge(Exception):
    """A body that is longer than it may be, or comes too slowly."""


@dataclass(frozen=True, slots=True)
class Guard:
    """An ASGI application around another one.

    names : host names by which browsers may reach the page, besides addresses
    body_max : largest body, by path, where it is not BODY_MAX [bytes]
    """

    app: ASGIApp
    names: frozenset[str]
    body_max: Mapping[str, int] = field(default_factory=dict)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request, or refuse it with the reason as JSON."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        secure = "https" in (scope["scheme"], headers.get("x-forwarded-proto"))  # here, or at a proxy
        sending = _with_headers(send, scope["path"], secure)
        refused = self._refusal(scope["method"], scope["scheme"], headers)
        if refused is not None:
            status, reason = refused
            await _refuse(status, reason)(scope, receive, sending)
            return
        try:
            body = (
                b""
                if scope["method"] in SAFE
                else await _body(receive, self.body_max.get(scope["path"], BODY_MAX))
            )
        except _TooLarge as error:
            await _refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, str(error))(scope, receive, sending)
            return
        await self.app(scope, receive if scope["method"] in SAFE else _receive_again(body, receive), sending)

    def _refusal(self, method: str, scheme: str, headers: Headers) -> tuple[HTTPStatus, str] | None:
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return HTTPStatus.MISDIRECTED_REQUEST, "this page has another name: see page.names"
        if method not in METHODS:
            return HTTPStatus.METHOD_NOT_ALLOWED, f"{method} is not served"
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            if method in SAFE and headers.get("sec-fetch-mode") == "navigate":
                return None  # a link on another site leads here
            return HTTPStatus.FORBIDDEN, "asked by a page of another site"
        if method in SAFE:
            return None
        if headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
            return HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "a change is sent as application/json"
        is_program = headers.get("authorization", "").startswith("Bearer ")  # no browser sends this by itself
        if not is_program and headers.get("origin") not in _origins(scheme, hosts[0], headers):
            return HTTPStatus.FORBIDDEN, "a change has to come from this page itself"
        return None

    def _is_ours(self, host: str) -> bool:
        name = _without_port(host)
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name.lower().rstrip(".") in self.names
        return True


def own_names(more: Iterable[str]) -> frozenset[str]:
    """Return the names of this machine, and those of the settings."""
    machine = socket.gethostname().lower()
    return frozenset({"localhost", machine, f"{machine.partition('.')[0]}.local", *map(str.lower, more)})


def _without_port(host: str) -> str:
    """Return the name or address, "" where it is not written as one."""
    found = _HOST.fullmatch(host)
    return found[1].strip("[]") if found else ""


def _origins(scheme: str, host: str, headers: Headers) -> tuple[str, ...]:
    """Return the origins of this page: behind a proxy that speaks https only the scheme differs."""
    return (f"{scheme}://{host}", f"https://{host}") if scheme == "http" else (f"{scheme}://{host}",)


async def _body(receive: Receive, body_max: int) -> bytes:
    """Return all of a body. Errors: _TooLarge"""
    parts, length = [], 0
    try:
        async with asyncio.timeout(BODY_MAX_S):
            while True:
                message = await receive()
                if message["type"] != "http.request":
                    raise _TooLarge("the request ended before its body did")
                parts.append(message.get("body", b""))
                length += len(parts[-1])
                if length > body_max:
                    raise _TooLarge(f"a request has {body_max} bytes at most")
                if not message.get("more_body", False):
                    return b"".join(parts)
    except TimeoutError:
        raise _TooLarge(f"the request did not end within {BODY_MAX_S:g} s") from None


def _receive_again(body: bytes, receive: Receive) -> Receive:
    """Return a `receive` that gives a body that is known, then what comes after it."""
    left = [body]

    async def give() -> Message:
        if left:
            return {"type": "http.request", "body": left.pop(), "more_body": False}
        return await receive()

    return give


def _with_headers(send: Send, path: str, secure: bool) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)  # a route may be stricter
            if secure:
                headers["strict-transport-security"] = f"max-age={HSTS_S}"
            headers["cache-control"] = "no-store" if path.startswith("/api/") else "no-cache"
        await send(message)

    return sending


def _refuse(status: HTTPStatus, reason: str) -> JSONResponse:
    return JSONResponse({"ok": False, "error": reason}, status)
