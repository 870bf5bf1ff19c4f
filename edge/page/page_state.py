"""The state that all routes share: the rig, who has access, tries of a password, open streams."""

import asyncio
import time
from collections import OrderedDict
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path

import anyio
from starlette.requests import Request

from edge.config.settings import Settings
from edge.core.event_log import Allowance
from edge.page.access import Access, Visitor
from edge.page.alarms.alarm_desk import AlarmDesk
from edge.page.answers import NotAllowed, in_thread
from edge.page.courses import Courses
from edge.page.questions import TwinQuestions
from edge.page.rig_link import RigLink

COOKIE = "greenhouse_session"
TRIES, TRY_EVERY_S = 5, 20.0  # of a password, by one address for one name: at once; at length [s]
TRIES_OF_ALL, TRIES_OF_ALL_S = 30, 1.0  # by all addresses for all names: each takes a quarter of a second
TESTS, TESTS_S = 5, 20.0  # of alarm channels: at once; at length [s]
TRIERS_MAX = 1000  # that are remembered


@dataclass(slots=True)
class Page:
    """The parts that all routes share."""

    settings: Settings
    access: Access
    rig: RigLink
    alarms: AlarmDesk
    questions: TwinQuestions
    courses: Courses
    alarm_tests: Allowance = field(default_factory=lambda: Allowance(TESTS, 1.0 / TESTS_S, time.monotonic))
    tries: OrderedDict[str, Allowance] = field(default_factory=OrderedDict)
    all_tries: Allowance = field(
        default_factory=lambda: Allowance(TRIES_OF_ALL, 1.0 / TRIES_OF_ALL_S, time.monotonic)
    )
    passwords: anyio.CapacityLimiter = field(  # each takes 16 MB: thirty at once would end the page
        default_factory=lambda: anyio.CapacityLimiter(1)
    )
    course_places: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(1))
    streams: dict[int, list[asyncio.Event]] = field(default_factory=dict)  # of each session, the oldest first
    is_exporting: bool = False  # the history is on its way to somebody

    @property
    def history(self) -> Path:
        """The daemon's database."""
        return Path(self.settings.history.path)

    async def visitor(self, request: Request) -> Visitor:
        """Return who asks. Errors: NotAllowed"""
        scheme, _, token = request.headers.get("authorization", "").partition(" ")
        secret = token if scheme == "Bearer" else request.cookies.get(COOKIE, "")
        found: Visitor | None = await in_thread(self.access.visitor, secret) if secret else None
        if found is None:
            raise NotAllowed(
                HTTPStatus.UNAUTHORIZED, "no session: open a link of `greenhouse page link`, or log in"
            )
        return found

    def may_try(self, request: Request, name: str) -> bool:
        """Take one of the tries that an address has for a name."""
        who = f"{request.client.host if request.client else ''} {name}"
        tries = self.tries.pop(who, None) or Allowance(TRIES, 1.0 / TRY_EVERY_S, time.monotonic)
        self.tries[who] = tries
        if len(self.tries) > TRIERS_MAX:
            self.tries.popitem(last=False)
        return self.all_tries.take() and tries.take()
