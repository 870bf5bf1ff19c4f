"""Routes of visitors: enter, leave, who has a session, links for others."""

import re
from http import HTTPStatus

from starlette.requests import Request
from starlette.responses import Response

from edge.config.settings import Settings
from edge.core.errors import RequestError
from edge.core.plain_text import plain
from edge.core.version import __version__
from edge.page.access import DAY_S, LINK_DAYS_MAX, NEEDS, RIGHTS, ROLES, Role, Visitor
from edge.page.answers import Json, NotAllowed, answer, document, in_thread, number, text
from edge.page.cookie import delete_cookie, set_cookie
from edge.page.page_state import Page


async def enter(page: Page, request: Request, _: Visitor) -> Response:
    """Begin a session by a link's secret, or by name and password."""
    given = await document(request)
    browser = request.headers.get("user-agent", "")
    if "link" in given:  # too long to be guessed
        begun = await in_thread(page.access.enter, text(given, "link"), browser)
        wrong = "this link is not valid any more, or was used already"
    else:
        name, password = text(given, "name", 40), text(given, "password")
        page.tries.take(request.client.host if request.client else "", name)
        begun = None
        if await in_thread(page.access.role_of, "people", name) is not None:
            begun = await page.tries.check(page.access.log_in, name, password, browser)
        else:
            await page.tries.pretend()
        wrong = "name or password is wrong"
    if begun is None:
        raise NotAllowed(HTTPStatus.UNAUTHORIZED, wrong)
    secret, visitor = begun
    response = answer(ok=True, **_me(visitor))
    set_cookie(request, response, secret)
    return response


async def leave(page: Page, request: Request, visitor: Visitor) -> Response:
    """End the visitor's own session."""
    await in_thread(page.access.revoke, "sessions", visitor.session)
    response = answer(ok=True)
    delete_cookie(response)
    return response


async def me(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return who asks, and what they may order."""
    return answer(ok=True, **_me(visitor), **_rig(page.settings))


def _rig(settings: Settings) -> Json:
    mqtt = settings.mqtt
    return {
        "rig": mqtt.rig,
        "broker": f"{mqtt.host}:{mqtt.port}" if mqtt.enabled else "",
        "controllers": settings.controllers,
        "version": __version__,
    }


def _me(visitor: Visitor) -> Json:
    may = [kind for kind, needed in NEEDS.items() if visitor.role >= needed]
    return {"name": visitor.name, "role": visitor.role.word, "session": visitor.session, "may": may}


async def sessions(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return all sessions, links and people; for one who operates, those that only look."""
    found = {kind: await in_thread(getattr(page.access, kind)) for kind in RIGHTS}
    if visitor.role < Role.ADMIN:
        found = {kind: [row for row in rows if row["role"] == Role.VIEW.word] for kind, rows in found.items()}
    return answer(ok=True, **found)


async def revoke(page: Page, request: Request, visitor: Visitor) -> Response:
    """End a session, a link with its sessions, or a person's password with theirs.

    One who operates may end what only looks: a link whose holder stops the rig again and again.
    """
    kind, key = request.path_params["kind"], request.path_params["key"]
    if kind not in RIGHTS:
        raise NotAllowed(HTTPStatus.NOT_FOUND, f"{kind}: one of {', '.join(RIGHTS)}")
    given = key if kind == "people" else _row(key)
    role = await in_thread(page.access.role_of, kind, given)
    if role is None:
        raise RequestError(f"{kind}: there is no {plain(key)}")
    if role > Role.VIEW and visitor.role < Role.ADMIN:
        raise NotAllowed(HTTPStatus.FORBIDDEN, f"to end the role {role.word} needs the role admin")
    ended = await in_thread(page.access.revoke, kind, given)
    page.streams.end(*(each for each in page.streams if each.session in ended))
    return answer(ok=True)


def _row(key: str) -> int:
    """Return the number of a row, 0 for what can be none."""
    return int(key) if re.fullmatch("[0-9]{1,18}", key, re.ASCII) else 0


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
