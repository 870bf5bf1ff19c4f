"""The state that all routes share: the rig, who has access, tries of a password, open streams."""

import asyncio
import time
from collections import Counter
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import Any

import anyio
from starlette.requests import Request

from edge.config.settings import Settings
from edge.core.event_log import Allowance
from edge.page.access import Access, Role, Visitor
from edge.page.alarms.alarm_desk import AlarmDesk
from edge.page.answers import NotAllowed, in_thread
from edge.page.cookie import secret_of
from edge.page.courses import Courses
from edge.page.password_tries import PasswordTries
from edge.page.questions import TwinQuestions
from edge.page.rig_link import RigLink

STREAMS_MAX = 40
TESTS, TESTS_S = 5, 20.0  # of alarm channels: at once; at length [s]
STOPS, STOPS_S = 2, 300.0  # that one link to view may set against releases: at once; at length [s]


@dataclass(slots=True, eq=False)
class Stream:
    """One that is open. owner : the link by which its viewer came, else their name"""

    session: int
    owner: int | str
    ended: asyncio.Event = field(default_factory=asyncio.Event)


class Streams(list[Stream]):
    """All that are open, the oldest first."""

    def begin(self, visitor: Visitor) -> Stream:
        """Return a new stream; the oldest one of whoever has most ends for it. Errors: NotAllowed"""
        begun = Stream(visitor.session, visitor.link or visitor.name)
        if len(self) >= STREAMS_MAX:
            counts = Counter(each.owner for each in self)
            owner = max(counts, key=lambda each: (counts[each], each == begun.owner))
            if counts[owner] == 1 and owner != begun.owner:  # no one has two
                raise NotAllowed(HTTPStatus.SERVICE_UNAVAILABLE, f"{STREAMS_MAX} viewers look already")
            self.end(next(each for each in self if each.owner == owner))
        self.append(begun)
        return begun

    def end(self, *streams: Stream) -> None:
        """End streams; one that has ended already stays so."""
        for each in streams:
            each.ended.set()
        self[:] = [each for each in self if not each.ended.is_set()]


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
    tries: PasswordTries = field(default_factory=PasswordTries)
    course_places: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(1))
    streams: Streams = field(default_factory=Streams)
    stops: dict[int | str, Allowance] = field(default_factory=dict)  # of each link, or person, who only looks
    is_exporting: bool = False  # the history is on its way to somebody

    @property
    def history(self) -> Path:
        """The daemon's database."""
        return Path(self.settings.history.path)

    async def stop(self, visitor: Visitor, author: str) -> dict[str, Any]:
        """Stop the rig. A stop is free for everybody, but a link to view can't defeat every release.

        Errors : NotAllowed for a link whose stops were released again and again
        """
        own = None
        if visitor.role is Role.VIEW:
            who = visitor.link or visitor.name  # people who log in have no link, and no share in each other's
            own = self.stops.setdefault(who, Allowance(STOPS, 1.0 / STOPS_S, time.monotonic))
        # A daemon that does not answer runs no control that a stop could disturb: the stop is left for it.
        if own is not None and not own.has_room and self.rig.view()["reached"]:
            status = await self.rig.ask({"do": "status"})
            if status.get("ok"):
                if status["operation"]["emergency_stop"]:
                    return {"ok": True, "changed": False}
                text = f"this link's stops were released {STOPS} times: ask who operates the rig, or wait"
                raise NotAllowed(HTTPStatus.TOO_MANY_REQUESTS, text)
        reply = await self.rig.stop(author)
        if own is not None and reply.get("changed", False):
            own.take()
        return reply

    async def visitor(self, request: Request) -> Visitor:
        """Return who asks. Errors: NotAllowed"""
        secret = secret_of(request)
        found: Visitor | None = await in_thread(self.access.visitor, secret) if secret else None
        if found is None:
            raise NotAllowed(
                HTTPStatus.UNAUTHORIZED, "no session: open a link of `greenhouse page link`, or log in"
            )
        return found
