"""The page as one ASGI application: its routes, who may call them, and the guard in front."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from http import HTTPStatus
from pathlib import Path

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from edge.config.settings import Settings
from edge.page import export, rig_routes, session_routes
from edge.page.access import Access, Role, Visitor
from edge.page.alarms import alarm_routes
from edge.page.alarms.alarm_desk import AlarmDesk
from edge.page.answers import NotAllowed, as_answer
from edge.page.courses import Courses
from edge.page.guard import Guard, own_names
from edge.page.page_state import Page
from edge.page.questions import TwinQuestions
from edge.page.rig_link import RigLink
from edge.sockets.stop_file import StopFile

Handler = Callable[[Page, Request, Visitor], Awaitable[Response]]

STATIC = Path(__file__).parent / "static"


API: tuple[tuple[str, str, Role | None, Handler], ...] = (
    ("POST", "/api/session", None, session_routes.enter),
    ("DELETE", "/api/session", Role.VIEW, session_routes.leave),
    ("GET", "/api/me", Role.VIEW, session_routes.me),
    ("GET", "/api/view", Role.VIEW, rig_routes.view),
    ("GET", "/api/stream", Role.VIEW, rig_routes.stream),
    ("GET", "/api/course", Role.VIEW, rig_routes.course),
    ("GET", "/api/span", Role.VIEW, rig_routes.span),
    ("GET", "/api/why", Role.VIEW, rig_routes.why),
    ("GET", "/api/what-if", Role.VIEW, rig_routes.what_if),
    ("GET", "/api/events", Role.VIEW, rig_routes.events),
    ("GET", "/api/models", Role.VIEW, rig_routes.models),
    ("GET", "/api/diagnoses", Role.VIEW, rig_routes.diagnoses),
    ("GET", "/api/diagnoses/{name}", Role.VIEW, rig_routes.diagnosis),
    ("GET", "/api/diagnoses/{name}/report", Role.VIEW, rig_routes.report),
    ("GET", "/api/export", Role.VIEW, export.export),
    ("POST", "/api/events/acknowledge", Role.OPERATE, rig_routes.acknowledge),
    ("POST", "/api/stop", Role.VIEW, rig_routes.stop),
    ("POST", "/api/order", Role.VIEW, rig_routes.order),
    ("GET", "/api/sessions", Role.OPERATE, session_routes.sessions),
    ("DELETE", "/api/{kind}/{key}", Role.OPERATE, session_routes.revoke),
    ("POST", "/api/links", Role.ADMIN, session_routes.make_link),
    ("GET", "/api/alarms", Role.OPERATE, alarm_routes.alarms),
    ("POST", "/api/alarms/test", Role.ADMIN, alarm_routes.test),
    ("POST", "/api/alarms/acknowledge", Role.OPERATE, alarm_routes.acknowledge),
)


def make_app(settings: Settings, file: str = "") -> Guard:
    """Return the application of a rig. file : of the settings, "" for every default"""
    rig = RigLink(Path(settings.control_socket.path), StopFile(settings.stop_folder))
    access = Access.of(settings.page.folder)
    courses = Courses(Path(settings.history.path))
    page = Page(settings, access, rig, AlarmDesk(settings, access, rig), TwinQuestions(file), courses)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(rig.watch()), asyncio.create_task(page.alarms.run())]
        yield
        for task in tasks:
            task.cancel()
        page.streams.end(*page.streams)

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

    async def serve(request: Request) -> Response:
        visitor = Visitor(0, "nobody", Role.VIEW) if needed is None else await page.visitor(request)
        if needed is not None and visitor.role < needed:
            reason = f"this needs the role {needed.word}, yours is {visitor.role.word}"
            raise NotAllowed(HTTPStatus.FORBIDDEN, reason)
        return await handler(page, request, visitor)

    async def endpoint(request: Request) -> Response:
        return await as_answer(serve(request))

    return endpoint
