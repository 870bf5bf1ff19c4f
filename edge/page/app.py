"""The page's routes: who asks, what they may, and the answer as JSON. One ASGI application, no globals."""

import asyncio
import contextlib
import json
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import Any

import anyio.to_thread
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from edge.config.settings import Settings
from edge.core.errors import GreenhouseError, RequestError
from edge.core.event_log import Allowance
from edge.core.messages import Severity
from edge.core.version import __version__
from edge.formats.reader import DocumentError, parse_json
from edge.page import history
from edge.page.access import DAY_S, ROLES, Access, Role, Visitor
from edge.page.guard import Guard, own_names
from edge.page.orders import NEEDS, problem
from edge.page.rig_link import RigLink
from edge.sockets.stop_file import StopFile

Json = dict[str, Any]
Handler = Callable[["Page", Request, Visitor], Awaitable[Response]]

STATIC = Path(__file__).parent / "static"
COOKIE = "greenhouse_session"
COOKIE_S = int(365 * DAY_S)  # the session ends before, on this side
STREAMS_MAX, STREAMS_OF_ONE = 40, 4
BEAT_S = 5.0  # between two signs of life on a quiet stream
TRIES, TRY_EVERY_S = 5, 20.0  # of a password, by one address for one name: at once; at length [s]
TRIES_OF_ALL, TRIES_OF_ALL_S = 30, 1.0  # by all addresses for all names: each takes a quarter of a second
TRIERS_MAX = 1000  # that are remembered
LINK_DAYS_MAX = 366.0


class NotAllowed(Exception):
    """A request without the right to it."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        super().__init__(reason)
        self.status = status


@dataclass(slots=True)
class Page:
    """The parts that all routes share."""

    settings: Settings
    access: Access
    rig: RigLink
    tries: "OrderedDict[str, Allowance]" = field(default_factory=OrderedDict)
    all_tries: Allowance = field(
        default_factory=lambda: Allowance(TRIES_OF_ALL, 1.0 / TRIES_OF_ALL_S, time.monotonic)
    )
    streams: "dict[int, list[asyncio.Event]]" = field(
        default_factory=dict
    )  # of each session, the oldest first

    @property
    def history(self) -> Path:
        """The daemon's database."""
        return Path(self.settings.history.path)

    async def visitor(self, request: Request) -> Visitor:
        """Return who asks. Errors: NotAllowed"""
        scheme, _, token = request.headers.get("authorization", "").partition(" ")
        secret = token if scheme == "Bearer" else request.cookies.get(COOKIE, "")
        found: Visitor | None = await in_thread(self.access.visitor, secret) if secret else None
        if found is None:
            raise NotAllowed(
                HTTPStatus.UNAUTHORIZED, "no session: open a link of `greenhouse page link`, or log in"
            )
        return found

    def may_try(self, request: Request, name: str) -> bool:
        """Take one of the tries that an address has for a name."""
        who = f"{request.client.host if request.client else ''} {name}"
        tries = self.tries.pop(who, None) or Allowance(TRIES, 1.0 / TRY_EVERY_S, time.monotonic)
        self.tries[who] = tries
        if len(self.tries) > TRIERS_MAX:
            self.tries.popitem(last=False)
        return self.all_tries.take() and tries.take()


async def in_thread(call: Callable[..., Any], *arguments: Any) -> Any:
    """Call something that waits for the disk."""
    return await anyio.to_thread.run_sync(call, *arguments)


def make_app(settings: Settings) -> Guard:
    """Return the application of a rig."""
    rig = RigLink(Path(settings.control_socket.path), StopFile(settings.stop_folder))
    page = Page(settings, Access(Path(settings.page.folder) / "page.db"), rig)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        watching = asyncio.create_task(rig.watch())
        yield
        watching.cancel()
        for streams in page.streams.values():
            for ended in streams:
                ended.set()

    routes = [
        *(
            Route(path, _endpoint(page, handler, needed), methods=[method])
            for method, path, needed, handler in API
        ),
        Route("/", lambda request: FileResponse(STATIC / "index.html")),
        Mount("/", StaticFiles(directory=STATIC), middleware=[Middleware(GZipMiddleware)]),
    ]
    return Guard(Starlette(routes=routes, lifespan=lifespan), own_names(settings.page.names))


def _endpoint(page: Page, handler: Handler, needed: Role | None) -> Callable[[Request], Awaitable[Response]]:
    """Wrap a handler: the visitor's role first, and each error as JSON. needed : None for anybody"""

    async def endpoint(request: Request) -> Response:
        try:
            visitor = Visitor(0, "nobody", Role.VIEW) if needed is None else await page.visitor(request)
            if needed is not None and visitor.role < needed:
                reason = f"this needs the role {needed.word}, yours is {visitor.role.word}"
                raise NotAllowed(HTTPStatus.FORBIDDEN, reason)
            return await handler(page, request, visitor)
        except NotAllowed as error:
            return answer(error.status, ok=False, error=str(error))
        except RequestError as error:
            return answer(HTTPStatus.BAD_REQUEST, ok=False, error=str(error))
        except GreenhouseError as error:
            return answer(HTTPStatus.SERVICE_UNAVAILABLE, ok=False, error=str(error))

    return endpoint


def answer(code: HTTPStatus = HTTPStatus.OK, /, **values: Any) -> JSONResponse:
    """Return values as JSON."""
    return JSONResponse(values, code)


async def document(request: Request) -> Json:
    """Return the JSON object of a request. Errors: RequestError"""
    try:
        return parse_json(await request.body(), "the body")
    except DocumentError as error:
        raise RequestError(str(error)) from None


def text(values: Mapping[str, Any], key: str, most: int = 200) -> str:
    """Return a text of a request. Errors: RequestError"""
    value = values.get(key)
    if not isinstance(value, str) or not 0 < len(value) <= most:
        raise RequestError(f"{key}: a text of 1 to {most} characters is needed")
    return value


def number(values: Mapping[str, Any], key: str, otherwise: float | None = None) -> float:
    """Return a number of a request or its address. Errors: RequestError"""
    value = values.get(key, otherwise)
    try:
        found = float("nan") if isinstance(value, bool) or value is None else float(value)
    except (TypeError, ValueError):
        found = float("nan")
    if not abs(found) < 1e12:
        raise RequestError(f"{key}: a number is needed")
    return found


# ---- sessions


async def enter(page: Page, request: Request, _: Visitor) -> Response:
    """Begin a session by a link's secret, or by name and password."""
    given = await document(request)
    browser = request.headers.get("user-agent", "")
    if "link" in given:  # too long to be guessed
        begun = await in_thread(page.access.enter, text(given, "link"), browser)
        wrong = "this link is not valid any more, or was used already"
    else:
        name, password = text(given, "name", 40), text(given, "password")
        if not page.may_try(request, name):
            raise NotAllowed(HTTPStatus.TOO_MANY_REQUESTS, f"too many tries: wait {TRY_EVERY_S:g} s")
        begun = await in_thread(page.access.log_in, name, password, browser)
        wrong = "name or password is wrong"
    if begun is None:
        raise NotAllowed(HTTPStatus.UNAUTHORIZED, wrong)
    secret, visitor = begun
    response = answer(ok=True, **_me(visitor))
    secure = request.url.scheme == "https" or request.headers.get("x-forwarded-proto") == "https"
    response.set_cookie(COOKIE, secret, max_age=COOKIE_S, httponly=True, samesite="strict", secure=secure)
    return response


async def leave(page: Page, request: Request, visitor: Visitor) -> Response:
    """End the visitor's own session."""
    await in_thread(page.access.revoke, visitor.session)
    response = answer(ok=True)
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return response


async def me(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return who asks, and what they may order."""
    return answer(ok=True, **_me(visitor), **_rig(page.settings))


def _rig(settings: Settings) -> Json:
    return {"rig": settings.mqtt.rig, "controllers": settings.controllers, "version": __version__}


def _me(visitor: Visitor) -> Json:
    may = [kind for kind, needed in NEEDS.items() if visitor.role >= needed]
    return {"name": visitor.name, "role": visitor.role.word, "session": visitor.session, "may": may}


async def sessions(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return all sessions."""
    return answer(ok=True, sessions=await in_thread(page.access.sessions))


async def revoke(page: Page, request: Request, visitor: Visitor) -> Response:
    """End a session, of whomever."""
    session = request.path_params["session"]
    if not await in_thread(page.access.revoke, session):
        raise RequestError(f"there is no session {session}")
    for ended in page.streams.get(session, ()):
        ended.set()
    return answer(ok=True)


async def make_link(page: Page, request: Request, visitor: Visitor) -> Response:
    """Make a link: to view for many, to operate for one."""
    given = await document(request)
    role = ROLES.get(text(given, "role"))
    if role is None:
        raise RequestError(f"role: one of {', '.join(ROLES)}")
    days = number(given, "days")
    if not 0.0 < days <= LINK_DAYS_MAX:
        raise RequestError(f"days: above 0, at most {LINK_DAYS_MAX:g}")
    uses = None if role is Role.VIEW else 1
    secret = await in_thread(page.access.make_link, role, text(given, "name", 40), days * DAY_S, uses)
    return answer(ok=True, link=secret, role=role.word, days=days)


# ---- what the rig does


async def view(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return what is known now."""
    page.rig.look_now()
    return answer(ok=True, **page.rig.view())


async def stream(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return what is known now, and again with every change, as server-sent events."""
    if sum(map(len, page.streams.values())) >= STREAMS_MAX:
        raise NotAllowed(HTTPStatus.SERVICE_UNAVAILABLE, f"{STREAMS_MAX} viewers look already")
    own = page.streams.setdefault(visitor.session, [])
    if len(own) >= STREAMS_OF_ONE:
        own.pop(0).set()
    ended = asyncio.Event()
    own.append(ended)
    return StreamingResponse(_views(page, visitor, ended), media_type="text/event-stream")


async def _views(page: Page, visitor: Visitor, ended: asyncio.Event) -> AsyncIterator[str]:
    page.rig.viewers += 1
    page.rig.look_now()
    try:
        while not ended.is_set():
            yield f"data: {json.dumps(page.rig.view(), separators=(',', ':'))}\n\n"
            await page.rig.next_news(BEAT_S)
    finally:
        page.rig.viewers -= 1
        own = page.streams.get(visitor.session, [])
        if ended in own:
            own.remove(ended)
        if not own:
            page.streams.pop(visitor.session, None)


async def course(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return columns of the history between two times."""
    given = request.query_params
    first_utc, last_utc = number(given, "from_utc"), number(given, "to_utc")
    points = int(number(given, "points", 600))
    return answer(ok=True, columns=await in_thread(history.course, page.history, first_utc, last_utc, points))


async def span(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return how far the history goes back."""
    return answer(ok=True, **await in_thread(history.span, page.history))


async def why(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return the reasons of the command that held at a time."""
    found = await page.rig.ask({"do": "why", "at_utc": number(request.query_params, "at_utc")})
    return _passed_on(found)


async def events(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return events, the newest first, and who has acknowledged them."""
    given = request.query_params
    kinds = tuple(severity.value for severity in Severity)
    least = given.get("least", kinds[0])
    if least not in kinds:
        raise RequestError(f"least: one of {', '.join(kinds)}")
    before_utc = number(given, "before_utc") if "before_utc" in given else None
    most = int(number(given, "most", 50))
    found = await in_thread(history.events, page.history, before_utc, kinds[kinds.index(least) :], most)
    first_seq = min((event["seq"] for event in found), default=0)
    seen = await in_thread(page.access.who_acknowledged, first_seq)
    rows = [event | {"acknowledged_by": seen.get((event["seq"], event["number"]))} for event in found]
    return answer(ok=True, events=rows)


async def acknowledge(page: Page, request: Request, visitor: Visitor) -> Response:
    """Note that the visitor has seen an alarm."""
    given = await document(request)
    seq, number_ = int(number(given, "seq")), int(number(given, "number"))
    await in_thread(page.access.acknowledge, seq, number_, visitor.name)
    return answer(ok=True)


async def stop(page: Page, request: Request, visitor: Visitor) -> Response:
    """Stop the rig."""
    return _passed_on(await page.rig.stop(_author(visitor)))


async def order(page: Page, request: Request, visitor: Visitor) -> Response:
    """Pass an order on to the daemon, with its author."""
    given = await document(request)
    if reason := problem(given, visitor.role):
        known = isinstance(given.get("do"), str) and given["do"] in NEEDS
        raise NotAllowed(HTTPStatus.FORBIDDEN if known else HTTPStatus.BAD_REQUEST, reason)
    if given["do"] == "emergency_stop":
        return await stop(page, request, visitor)
    return _passed_on(await page.rig.ask(given | {"by": _author(visitor)}))


def _author(visitor: Visitor) -> str:
    return f"{visitor.name} (page)"


def _passed_on(found: Json) -> JSONResponse:
    """Return the daemon's answer; its refusals are the asker's fault, its silence is not."""
    if found.get("ok"):
        return JSONResponse(found)
    status = HTTPStatus.GATEWAY_TIMEOUT if found.pop("unreached", False) else HTTPStatus.BAD_REQUEST
    return JSONResponse(found, status)


API: tuple[tuple[str, str, Role | None, Handler], ...] = (
    ("POST", "/api/session", None, enter),
    ("DELETE", "/api/session", Role.VIEW, leave),
    ("GET", "/api/me", Role.VIEW, me),
    ("GET", "/api/view", Role.VIEW, view),
    ("GET", "/api/stream", Role.VIEW, stream),
    ("GET", "/api/course", Role.VIEW, course),
    ("GET", "/api/span", Role.VIEW, span),
    ("GET", "/api/why", Role.VIEW, why),
    ("GET", "/api/events", Role.VIEW, events),
    ("POST", "/api/events/acknowledge", Role.OPERATE, acknowledge),
    ("POST", "/api/stop", Role.VIEW, stop),
    ("POST", "/api/order", Role.VIEW, order),
    ("GET", "/api/sessions", Role.ADMIN, sessions),
    ("DELETE", "/api/sessions/{session:int}", Role.ADMIN, revoke),
    ("POST", "/api/links", Role.ADMIN, make_link),
)
