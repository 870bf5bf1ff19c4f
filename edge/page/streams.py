"""The places of event streams: where none is left, whoever has most makes room."""

import asyncio
from collections import Counter
from dataclasses import dataclass, field
from http import HTTPStatus

from edge.page.access import Visitor
from edge.page.answers import NotAllowed

STREAMS_MAX = 40


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
            if counts[owner] == 1 and owner != begun.owner:  # nobody has two
                raise NotAllowed(HTTPStatus.SERVICE_UNAVAILABLE, f"{STREAMS_MAX} viewers look already")
            self.end(next(each for each in self if each.owner == owner))
        self.append(begun)
        return begun

    def end(self, *streams: Stream) -> None:
        """End streams; one that has ended already stays so."""
        for each in streams:
            each.ended.set()
        self[:] = [each for each in self if not each.ended.is_set()]
