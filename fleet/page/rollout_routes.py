"""Routes of rollouts: shown, and let go on or stopped by a person."""

import time
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from sqlalchemy import Engine
from starlette.requests import Request
from starlette.responses import Response

from edge.core.plain_text import plain
from edge.page.access import Role
from edge.page.answers import NotAllowed, answer, document, in_thread, text
from fleet.page.fleet_page import FleetPage, refuse_below, row_number
from fleet.page.people import FleetVisitor
from fleet.rollout.begin import go_on_by_person, stop_by_person
from fleet.rollout.overview import group_of, newest

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
