"""Routes of the rig: what it does, did and why; orders, the stop, models and reports."""

import json
from collections.abc import AsyncIterator
from http import HTTPStatus
from pathlib import Path

from starlette.requests import Request
from starlette.responses import HTMLResponse, Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from edge.core.errors import RequestError
from edge.core.messages import Severity
from edge.core.stop_words import as_stop
from edge.page import history, reports
from edge.page.access import NEEDS, Visitor, order_problem
from edge.page.answers import NotAllowed, answer, document, in_thread, number, passed_on
from edge.page.page_state import Page, Stream
from edge.page.questions import options

BEAT_S = 5.0  # between two signs of life on a quiet stream


async def view(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return what is known now."""
    page.rig.look_now()
    return answer(ok=True, **page.rig.view())


async def stream(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return what is known now, and again with every change, as server-sent events."""
    return _Views(page, page.streams.begin(visitor))


class _Views(StreamingResponse):
    """Views on their way; whoever hangs up before the first of them gives the place back too."""

    def __init__(self, page: Page, begun: Stream) -> None:
        super().__init__(_views(page, begun), media_type="text/event-stream")
        self._page, self._begun = page, begun

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send them, and free the place for the next viewer."""
        self._page.rig.viewers += 1
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._page.rig.viewers -= 1
            self._page.streams.end(self._begun)


async def _views(page: Page, begun: Stream) -> AsyncIterator[str]:
    page.rig.look_now()
    while not begun.ended.is_set():
        yield f"data: {json.dumps(page.rig.view(), separators=(',', ':'))}\n\n"
        await page.rig.next_news(BEAT_S)


async def course(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return columns of the history between two times."""
    given = request.query_params
    first_utc, last_utc = number(given, "from_utc"), number(given, "to_utc")
    points = int(number(given, "points", 600))
    read = page.courses.between
    return answer(
        ok=True, columns=await in_thread(read, first_utc, last_utc, points, places=page.course_places)
    )


async def span(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return how far the history goes back, and how much room the disk has for more."""
    return answer(ok=True, **await in_thread(history.span, page.history))


async def why(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return the reasons of the command that held at a time."""
    found = await page.rig.ask({"do": "why", "at_utc": number(request.query_params, "at_utc")})
    return passed_on(found)


async def what_if(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return the twin's answer to a question."""
    return answer(**await page.questions.ask(options(request.query_params)))


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
    seq, place = int(number(given, "seq")), int(number(given, "number"))
    if not await in_thread(history.has_alarm, page.history, seq, place):
        raise RequestError(f"there is no alarm {place} of tick {seq}")
    await in_thread(page.access.acknowledge, seq, place, visitor.name)
    return answer(ok=True)


async def stop(page: Page, request: Request, visitor: Visitor) -> Response:
    """Stop the rig."""
    return passed_on(await page.stop(visitor, _author(visitor)))


async def order(page: Page, request: Request, visitor: Visitor) -> Response:
    """Pass an order on to the daemon, with its author."""
    given = as_stop(await document(request))
    if reason := order_problem(given, visitor.role):
        known = isinstance(given.get("do"), str) and given["do"] in NEEDS
        raise NotAllowed(HTTPStatus.FORBIDDEN if known else HTTPStatus.BAD_REQUEST, reason)
    if given["do"] == "emergency_stop":
        return await stop(page, request, visitor)
    return passed_on(await page.rig.ask({**given, "by": _author(visitor)}))


def _author(visitor: Visitor) -> str:
    return f"{visitor.name} (page)"


# A report holds names of files and notes of people: nothing in it runs, is sent, or is fetched.
SANDBOX = {
    "content-security-policy": (
        "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; "
        "base-uri 'none'; form-action 'none'"
    )
}


async def models(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return all installed bundles, and which one does what."""
    return passed_on(await page.rig.ask({"do": "bundle", "action": "list"}))


async def diagnoses(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return the last reports, each with its verdict."""
    return answer(ok=True, reports=await in_thread(reports.summaries, _folder(page)))


async def diagnosis(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return the figures and the evidence of a report."""
    return answer(ok=True, **await in_thread(reports.details, await _report(page, request)))


async def report(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return a report for people, in which nothing can act."""
    content = await in_thread(reports.html, await _report(page, request))
    return HTMLResponse(content, headers=SANDBOX)


def _folder(page: Page) -> Path:
    return Path(page.settings.drift.reports)


async def _report(page: Page, request: Request) -> Path:
    """Return the folder of the report that is asked for. Errors: NotAllowed"""
    name, folder = str(request.path_params["name"]), _folder(page)
    if name not in await in_thread(reports.names, folder):
        raise NotAllowed(HTTPStatus.NOT_FOUND, "there is no report of this name")
    return folder / name
