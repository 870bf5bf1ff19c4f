"""The places of event streams: a few for a session, and a fair share for each link."""

import asyncio
from collections import Counter
from dataclasses import dataclass, field
from http import HTTPStatus

from edge.page.access import Visitor
from edge.page.answers import NotAllowed

STREAMS_MAX, STREAMS_OF_ONE = 40, 4


@dataclass(slots=True, eq=False)
class Stream:
    """One that is open. owner : the link by which its viewer came, else their name"""

    session: int
    owner: int | str
    ended: asyncio.Event = field(default_factory=asyncio.Event)


@dataclass(slots=True)
class Streams:
    """All that are open, the oldest first."""

    open: list[Stream] = field(default_factory=list)

    def begin(self, visitor: Visitor) -> Stream:
        """Return a new stream. The oldest one of whoever has most makes room. Errors: NotAllowed"""
        begun = Stream(visitor.session, visitor.link or visitor.name)
        own = [each for each in self.open if each.session == begun.session]
        if len(own) >= STREAMS_OF_ONE:
            self.end(own[0])
        elif len(self.open) >= STREAMS_MAX:
            counts = Counter(each.owner for each in self.open)
            owner = max(counts, key=lambda each: (counts[each], each == begun.owner))
            if counts[owner] == 1 and owner != begun.owner:  # nobody has two
                raise NotAllowed(HTTPStatus.SERVICE_UNAVAILABLE, f"{STREAMS_MAX} viewers look already")
            self.end(next(each for each in self.open if each.owner == owner))
        self.open.append(begun)
        return begun

    def end(self, *streams: Stream) -> None:
        """End streams, those among them that have ended already too."""
        for each in streams:
            each.ended.set()
        self.open = [each for each in self.open if each not in streams]
