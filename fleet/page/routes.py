"""Routes of the fleet's page: enter and leave, rigs, orders, alarms, sessions, rollouts."""

import hmac
import json
import time
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from sqlalchemy import Engine, update
from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response

from edge.core.errors import RequestError
from edge.core.plain_text import plain
from edge.core.version import __version__
from edge.formats.reader import DocumentError
from edge.page.access import Role
from edge.page.answers import NotAllowed, answer, document, in_thread, number, text
from edge.page.cookie import delete_cookie, secret_of, set_cookie
from fleet.database.tables import FleetOrder, ToldTwin
from fleet.page import series
from fleet.page.alarm_shelf import read_alerts
from fleet.page.fleet_page import FleetPage, refuse_below, row_number
from fleet.page.order_desk import OrderDesk, check, payload_of
from fleet.page.people import EVERY, FleetVisitor
from fleet.page.rig_list import Wanted
from fleet.page.standing import STANDINGS
from fleet.rollout.archives import SUFFIX, archive_bytes
from fleet.rollout.begin import go_on_by_person, stop_by_person
from fleet.rollout.overview import group_of, newest

Json = dict[str, Any]
ALERTS = "/api/v2/alerts"  # Alertmanager's, where vmalert posts
SEARCH_MAX = 100  # characters


def known_twin(engine: Engine, rig: str) -> Json | None:
    """Return its bundle, its time and the effects of its document, None before the rig has told any."""
    with Session(engine) as session:
        twin = session.get(ToldTwin, rig)
        if twin is None:
            return None
        return {"bundle": twin.bundle, "utc": twin.utc, "effects": twin.document.get("effects") or {}}


async def enter(page: FleetPage, request: Request) -> Response:
    """Begin a session by name and password."""
    given = await document(request)
    name, password = text(given, "name", 40), text(given, "password")
    page.tries.take(_address(request), name)
    browser = request.headers.get("user-agent", "")
    begun = await in_thread(page.people.log_in, name, password, browser, places=page.tries.places)
    if begun is None:
        raise NotAllowed(HTTPStatus.UNAUTHORIZED, "name or password is wrong")
    secret, visitor = begun
    response = answer(ok=True, **_me(visitor))
    set_cookie(request, response, secret)
    return response


def _address(request: Request) -> str:
    """Return who asks; from this machine it is caddy, which names the browser's address last."""
    peer = request.client.host if request.client else ""
    forwarded = request.headers.get("x-forwarded-for", "").rpartition(",")[2].strip()
    return forwarded if forwarded and peer in ("127.0.0.1", "::1") else peer


async def leave(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """End the visitor's own session."""
    await in_thread(page.people.end_session, visitor.session)
    response = answer(ok=True)
    delete_cookie(response)
    return response


async def me(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """Return who asks, and their roles."""
    return answer(ok=True, version=__version__, **_me(visitor))


def _me(visitor: FleetVisitor) -> dict[str, Any]:
    return {"name": visitor.name, "roles": {group: role.word for group, role in visitor.rights.items()}}


async def rigs(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """Return rigs, the worst first. Optional: group, kind, standing, search."""
    given = {key: value[:SEARCH_MAX] for key, value in request.query_params.items()}
    standing = given.get("standing", "")
    if standing and standing not in STANDINGS:
        raise RequestError(f"standing: one of {', '.join(STANDINGS)}")
    wanted = Wanted(
        visitor.groups,
        given.get("group", ""),
        given.get("kind", ""),
        STANDINGS.get(standing),
        given.get("search", ""),
    )
    drifts = {} if page.desk is None else page.desk.drifts
    listing = await in_thread(page.rigs.listing, wanted, drifts, time.time())
    return answer(ok=True, **listing, **await page.health(visitor), utc=time.time())


async def rig(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """Return one rig: its state, its newest twin and the verdict on it, and the visitor's role over it."""
    found = await page.rig(visitor, request.path_params["name"])
    role = visitor.role(found.group)
    return answer(
        ok=True,
        **found.row(),
        state=dict(found.state),
        drift=dict(found.drift),
        twin=await in_thread(known_twin, page.engine, found.name),
        role=role and role.word,
        utc=time.time(),
    )


async def course(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """Return columns of a rig's numbers between two times."""
    found = await page.rig(visitor, request.path_params["name"])
    given = request.query_params
    first_utc, last_utc = number(given, "from_utc"), number(given, "to_utc")
    if not 0.0 < last_utc - first_utc <= series.SPAN_MAX_S:
        raise RequestError(f"to_utc: after from_utc, by {series.SPAN_MAX_S:g} s at most")
    points = int(number(given, "points", 720))
    columns = await in_thread(
        series.course,
        page.settings.numbers,
        found.name,
        first_utc,
        last_utc,
        points,
        places=page.course_places,
    )
    return answer(ok=True, columns=columns)


async def order(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """Send an order to a rig of a group in which the visitor may, and return the rig's answer."""
    found = await page.rig(visitor, request.path_params["name"])
    given = await document(request)
    what, payload = text(given, "what", 40), payload_of(given.get("payload", ""))
    check(what, payload, visitor.role(found.group))
    if page.desk is None:
        raise NotAllowed(HTTPStatus.SERVICE_UNAVAILABLE, "no broker is configured: mqtt.enabled is false")
    noted = FleetOrder(
        rig=found.name, person=visitor.name, utc=time.time(), what=what, payload=payload, answer=None
    )
    place = await in_thread(_note_order, page, noted)
    return await _give(page, page.desk, place, found.name, what, payload)


async def _give(
    page: FleetPage, desk: OrderDesk, place: int, rig_name: str, what: str, payload: str
) -> Response:
    try:
        found = await desk.give(rig_name, what, payload)
    except NotAllowed as error:
        await in_thread(_note_answer, page, place, str(error))
        raise
    await in_thread(_note_answer, page, place, json.dumps(found))
    return answer(HTTPStatus.OK if found.get("ok") else HTTPStatus.BAD_REQUEST, **found)


def _note_order(page: FleetPage, noted: FleetOrder) -> int:
    with Session(page.engine) as session, session.begin():
        session.add(noted)
        session.flush()
        return noted.id


def _note_answer(page: FleetPage, place: int, words: str) -> None:
    with Session(page.engine) as session, session.begin():
        session.execute(update(FleetOrder).where(FleetOrder.id == place).values(answer=words))


async def alarms(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """Return alarms of the visitor's groups, the newest first; `lasting=1`: those that have not ended."""
    given = request.query_params
    before_utc = number(given, "before_utc") if "before_utc" in given else None
    lasting = given.get("lasting") == "1"
    found = await in_thread(page.alarms.newest, visitor.groups, lasting, before_utc)
    return answer(ok=True, alarms=found, **await page.health(visitor))


async def acknowledge(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """Note that the visitor has seen an alarm."""
    place = row_number(request)
    group = await in_thread(page.alarms.group_of, place)
    if group is None or visitor.role(group) is None:
        raise NotAllowed(HTTPStatus.NOT_FOUND, "there is no such alarm in your groups")
    refuse_below(Role.OPERATE, visitor.role(group))
    await in_thread(page.alarms.acknowledge, place, visitor.name)
    return answer(ok=True)


async def bundle(page: FleetPage, request: Request) -> Response:
    """Return a bundle's archive, to any rig: it is signed, and its hash is its name."""
    sha256 = request.path_params["name"].removesuffix(SUFFIX)
    content = await in_thread(archive_bytes, page.engine, sha256)
    if content is None:
        raise NotAllowed(HTTPStatus.NOT_FOUND, "there is no such bundle")
    return Response(content, media_type="application/zip")


async def take_alerts(page: FleetPage, request: Request) -> Response:
    """Store what vmalert posts; it shows who it is by a word that only the two know."""
    if not page.alert_token or not hmac.compare_digest(
        secret_of(request).encode(), page.alert_token.encode()
    ):
        raise NotAllowed(HTTPStatus.UNAUTHORIZED, "page.alert_token_file: this is not its word")
    try:
        found = read_alerts(json.loads(await request.body()))
    except (DocumentError, ValueError, RecursionError) as error:
        raise RequestError(str(error)) from None
    await in_thread(page.alarms.take, found)
    return answer(ok=True)


async def sessions(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """Return all sessions."""
    refuse_below(Role.ADMIN, visitor.rights.get(EVERY))
    return answer(ok=True, sessions=await in_thread(page.people.sessions))


async def end_session(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """End a session, of whomever."""
    refuse_below(Role.ADMIN, visitor.rights.get(EVERY))
    session = row_number(request, "session")
    if not await in_thread(page.people.end_session, session):
        raise RequestError(f"there is no session {session}")
    return answer(ok=True)


SHOWN_MAX = 50
Decide = Callable[[Engine, int, str, float], Any]


async def rollouts(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """Return rollouts of the visitor's groups, the newest first, with the visitor's role over each."""
    found = await in_thread(newest, page.engine, visitor.groups, time.time(), SHOWN_MAX)
    for rollout in found["rollouts"]:
        role = visitor.role(rollout["group"])
        rollout["role"] = role and role.word
    return answer(ok=True, **found, **await page.health(visitor), utc=time.time())


async def go_on(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """Let a wave go on that is held. Optional: why."""
    return await _decide(page, request, visitor, go_on_by_person, "let it go on")


async def stop(page: FleetPage, request: Request, visitor: FleetVisitor) -> Response:
    """End a rollout; its rigs roll back. Optional: why."""
    return await _decide(page, request, visitor, stop_by_person, "stopped it")


async def _decide(
    page: FleetPage, request: Request, visitor: FleetVisitor, decide: Decide, done: str
) -> Response:
    number = row_number(request)
    group = await in_thread(group_of, page.engine, number)
    # One of another group is answered like one that does not exist.
    if group is None or visitor.role(group) is None:
        raise NotAllowed(HTTPStatus.NOT_FOUND, "there is no such rollout in your groups")
    refuse_below(Role.ADMIN, visitor.role(group))
    given = await document(request) if await request.body() else {}
    why = f": {plain(text(given, 'why'))}" if "why" in given else ""
    await in_thread(decide, page.engine, number, f"{visitor.name} {done}{why}", time.time())
    return answer(ok=True)
