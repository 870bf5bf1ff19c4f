"""Parts of every route: values of a request, checked; answers as JSON; work that waits for the disk."""

from collections.abc import Awaitable, Callable, Mapping
from http import HTTPStatus
from typing import Any

import anyio
import anyio.to_thread
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from edge.core.errors import GreenhouseError, RequestError
from edge.formats.reader import DocumentError, parse_json

Json = dict[str, Any]
UTC_MAX = 253_402_300_799.0  # the last second of the year 9999, the calendar's end [s since 1970]


class NotAllowed(Exception):
    """A request without the right to it."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        super().__init__(reason)
        self.status = status


async def as_answer(work: Awaitable[Response]) -> Response:
    """Return a route's answer; a refusal or an error becomes JSON with the reason."""
    try:
        return await work
    except NotAllowed as error:
        return answer(error.status, ok=False, error=str(error))
    except RequestError as error:
        return answer(HTTPStatus.BAD_REQUEST, ok=False, error=str(error))
    except GreenhouseError as error:
        return answer(HTTPStatus.SERVICE_UNAVAILABLE, ok=False, error=str(error))


async def in_thread(
    call: Callable[..., Any], *arguments: Any, places: anyio.CapacityLimiter | None = None
) -> Any:
    """Call something that waits for the disk, or that computes for long.

    places : how many such calls may run at once, None for those that all calls share
    """
    return await anyio.to_thread.run_sync(call, *arguments, limiter=places)


def answer(code: HTTPStatus = HTTPStatus.OK, /, **values: Any) -> JSONResponse:
    """Return values as JSON."""
    return JSONResponse(values, code)


def passed_on(found: Json) -> JSONResponse:
    """Return the daemon's answer; its refusals are the asker's fault, its silence is not."""
    if found.get("ok"):
        return JSONResponse(found)
    status = HTTPStatus.GATEWAY_TIMEOUT if found.pop("unreached", False) else HTTPStatus.BAD_REQUEST
    return JSONResponse(found, status)


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
    is_time = key.endswith("_utc")
    if not (0.0 <= found <= UTC_MAX if is_time else abs(found) < 1e12):
        raise RequestError(f"{key}: a {'time from 1970 to 9999' if is_time else 'number'} is needed")
    return found
