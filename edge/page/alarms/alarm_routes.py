"""Routes of the alarms by message: how the channels do, a test, an acknowledgement."""

from http import HTTPStatus

from starlette.requests import Request
from starlette.responses import Response

from edge.page.access import Visitor
from edge.page.answers import NotAllowed, answer, document, number, text
from edge.page.page_state import Page


async def alarms(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return channels and open alarms; of addresses the host alone, as the rest may be secret."""
    return answer(ok=True, **page.alarms.json())


async def test(page: Page, request: Request, visitor: Visitor) -> Response:
    """Send a test message by one channel, and say how it went."""
    name = text(await document(request), "channel", 40)
    if not page.alarm_tests.take():
        raise NotAllowed(HTTPStatus.TOO_MANY_REQUESTS, "too many tests: wait 20 s")
    if reason := await page.alarms.test(name):
        return answer(HTTPStatus.BAD_GATEWAY, ok=False, error=reason)
    return answer(ok=True)


async def acknowledge(page: Page, request: Request, visitor: Visitor) -> Response:
    """Note that the visitor has seen an alarm: it is not repeated."""
    await page.alarms.acknowledge(int(number(await document(request), "id")), visitor.name)
    return answer(ok=True)
