"""Routes of models: bundles as the daemon has them, and the reports of diagnoses."""

from http import HTTPStatus
from pathlib import Path

from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from edge.page import reports
from edge.page.access import Visitor
from edge.page.answers import NotAllowed, answer, in_thread, passed_on
from edge.page.page_state import Page

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
