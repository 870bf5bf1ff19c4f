"""Route of the export: a stretch of the history as a run file, in pieces, one export at a time."""

import asyncio
import contextlib
from datetime import UTC, datetime
from functools import partial
from http import HTTPStatus
from itertools import chain

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Message, Receive, Scope, Send

from edge.core.errors import DataError, RequestError
from edge.page import history
from edge.page.access import Visitor
from edge.page.answers import NotAllowed, in_thread, number
from edge.page.page_state import Page
from edge.storage.run_rows import run_text

STALL_MAX_S = 30.0  # for a reader to take the next piece; others wait for it
WHOLE_MAX_S = 900.0  # for all of it: a year of minutes, 30 MB, by 270 kbit/s


async def export(page: Page, request: Request, visitor: Visitor) -> Response:
    """Return the rig's ticks between two times as a run file, as `greenhouse export` writes it."""
    given = request.query_params
    first_utc, last_utc = number(given, "from_utc"), number(given, "to_utc")
    if not first_utc < last_utc:
        raise RequestError("from_utc has to be before to_utc")
    if page.is_exporting:
        raise NotAllowed(HTTPStatus.SERVICE_UNAVAILABLE, "another export is under way: try again after it")
    page.is_exporting = True
    try:
        pieces = run_text(page.history, first_utc, last_utc, partial(history.reading, page.history))
        head = await in_thread(next, pieces)  # all that can be wrong with the stretch is found here
        return _RunFile(page, chain([head], pieces), first_utc)
    except BaseException as error:
        page.is_exporting = False
        if isinstance(error, DataError):
            raise NotAllowed(HTTPStatus.NOT_FOUND, str(error)) from None
        raise


class _RunFile(StreamingResponse):
    """A run file on its way. A reader that does not read is left, so that the next one gets the place."""

    def __init__(self, page: Page, pieces: chain[str], first_utc: float) -> None:
        day = datetime.fromtimestamp(first_utc, UTC).strftime("%Y-%m-%d")
        headers = {"content-disposition": f'attachment; filename="greenhouse_{day}.csv"'}
        super().__init__(pieces, media_type="text/csv", headers=headers)
        self._page = page

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it, and free the place for the next one."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._page.is_exporting = False

    async def stream_response(self, send: Send) -> None:
        """Send the pieces; a reader that is too slow gets no end, and so knows that rows are missing."""

        async def within_time(message: Message) -> None:
            async with asyncio.timeout(STALL_MAX_S):
                await send(message)

        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(WHOLE_MAX_S):
                await super().stream_response(within_time)
