"""Limits of how often a password may be tried, and of how many are checked at once.

Attempts with invented names cost a person with the right password neither tries nor time: the two kinds of
name have separate places. Neither the words nor the time of an answer reveal whether a name exists.
"""

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any

import anyio

from edge.core.event_log import Allowance
from edge.page.answers import NotAllowed, in_thread
from edge.page.secret_hashes import NOBODY, is_password

TRIES, TRY_EVERY_S = 5, 20.0  # of a password, by one address for one name: at once; at length [s]
TRIES_OF_ALL, TRIES_OF_ALL_S = 30, 1.0  # by all addresses for one name: each takes a quarter of a second
TRIERS_MAX = 1000  # that are remembered


@dataclass(slots=True)
class PasswordTries:
    """The tries so far. places : each check takes 16 MB, so thirty at once would end the page"""

    own: OrderedDict[str, Allowance] = field(default_factory=OrderedDict)
    by_name: OrderedDict[str, Allowance] = field(default_factory=OrderedDict)
    places: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(1))
    check_s: float | None = None  # what the last check took

    def take(self, address: str, name: str) -> None:
        """Take one of the tries that an address has for a name. Errors: NotAllowed"""
        own = _allowance(self.own, f"{address} {name}", TRIES, TRY_EVERY_S)
        everybodys = _allowance(self.by_name, name, TRIES_OF_ALL, TRIES_OF_ALL_S)
        if not (own.take() and everybodys.take()):
            raise NotAllowed(HTTPStatus.TOO_MANY_REQUESTS, f"too many tries: wait {TRY_EVERY_S:g} s")

    async def pretend(self) -> None:
        """Take the time of a check, and nothing else, for a name that does not exist."""
        if self.check_s is None:
            await self.check(is_password, "", *NOBODY)
        else:
            await anyio.sleep(self.check_s)

    async def check(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call what checks a password, in a thread and one at a time."""
        async with self.places:
            begun_s = time.monotonic()
            found = await in_thread(call, *arguments)
            self.check_s = time.monotonic() - begun_s
        return found


def _allowance(known: OrderedDict[str, Allowance], key: str, at_once: int, every_s: float) -> Allowance:
    found = known.pop(key, None) or Allowance(at_once, 1.0 / every_s, time.monotonic)
    known[key] = found
    if len(known) > TRIERS_MAX:
        known.popitem(last=False)
    return found
