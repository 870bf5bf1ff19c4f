"""The fleet's page as one ASGI application: its routes, and the guard of a rig's page in front."""

import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from edge.config.secrets import read_secret
from edge.core.errors import DataError
from edge.page.answers import as_answer
from edge.page.app import STATIC as PARTS
from edge.page.guard import Guard, own_names
from fleet.database.base import open_database
from fleet.page import routes
from fleet.page.alarm_shelf import AlarmShelf
from fleet.page.fleet_page import FleetPage
from fleet.page.order_desk import OrderDesk
from fleet.page.people import FleetVisitor, People
from fleet.page.rig_list import RigList
from fleet.rollout.archives import BUNDLES
from fleet.settings import FleetSettings

STATIC = Path(__file__).parent / "static"
ALERTS_MAX = 8 << 20  # bytes of one post: every rig silent at once, some 20 000
FleetHandler = Callable[[FleetPage, Request, FleetVisitor], Awaitable[Response]]
OpenHandler = Callable[[FleetPage, Request], Awaitable[Response]]

OPEN: tuple[tuple[str, str, OpenHandler], ...] = (
    ("POST", "/api/session", routes.enter),
    ("POST", routes.ALERTS, routes.take_alerts),
    ("GET", f"{BUNDLES}/{{name}}", routes.bundle),
)
API: tuple[tuple[str, str, FleetHandler], ...] = (
    ("DELETE", "/api/session", routes.leave),
    ("GET", "/api/me", routes.me),
    ("GET", "/api/rigs", routes.rigs),
    ("GET", "/api/rigs/{name}", routes.rig),
    ("GET", "/api/rigs/{name}/course", routes.course),
    ("POST", "/api/rigs/{name}/order", routes.order),
    ("GET", "/api/alarms", routes.alarms),
    ("POST", "/api/alarms/{number:int}/acknowledge", routes.acknowledge),
    ("GET", "/api/rollouts", routes.rollouts),
    ("POST", "/api/rollouts/{number:int}/go-on", routes.go_on),
    ("POST", "/api/rollouts/{number:int}/stop", routes.stop),
    ("GET", "/api/sessions", routes.sessions),
    ("DELETE", "/api/sessions/{session:int}", routes.end_session),
)


def make_fleet_app(settings: FleetSettings) -> Guard:
    """Return the application of a fleet. Errors: DataError, ConfigError"""
    engine = open_database(settings.database)
    token_file = settings.page.alert_token_file
    token = read_secret(token_file, "page.alert_token_file").value if token_file else ""
    page = FleetPage(settings, engine, People(engine), AlarmShelf(engine), RigList(engine), token)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        page.desk = OrderDesk(settings.mqtt) if settings.mqtt.enabled else None
        try:
            yield
        finally:
            if page.desk is not None:
                page.desk.close()
            engine.dispose()

    found = [
        *(Route(path, _for_anybody(page, handler), methods=[method]) for method, path, handler in OPEN),
        *(Route(path, _for_visitors(page, handler), methods=[method]) for method, path, handler in API),
        Route("/", lambda request: FileResponse(STATIC / "index.html")),
        Mount("/fleet", StaticFiles(directory=STATIC), middleware=[Middleware(GZipMiddleware)]),
        Mount("/", StaticFiles(directory=PARTS), middleware=[Middleware(GZipMiddleware)]),
    ]
    app = Starlette(routes=found, lifespan=lifespan)
    return Guard(app, own_names(settings.page.names), {routes.ALERTS: ALERTS_MAX})


def _for_anybody(page: FleetPage, handler: OpenHandler) -> Callable[[Request], Awaitable[Response]]:
    async def endpoint(request: Request) -> Response:
        return await as_answer(_with_database(handler(page, request)))

    return endpoint


def _for_visitors(page: FleetPage, handler: FleetHandler) -> Callable[[Request], Awaitable[Response]]:
    async def serve(request: Request) -> Response:
        return await handler(page, request, await page.visitor(request))

    async def endpoint(request: Request) -> Response:
        return await as_answer(_with_database(serve(request)))

    return endpoint


async def _with_database(work: Awaitable[Response]) -> Response:
    """Let a database that is away be an error with a reason. Errors: DataError"""
    try:
        return await work
    except SQLAlchemyError as error:
        raise DataError(f"the database does not answer: {type(error).__name__}") from error
