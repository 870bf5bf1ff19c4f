"""Limits of how often a password may be tried, and of how many are checked at once."""

import time
from collections import OrderedDict
from dataclasses import dataclass, field
from http import HTTPStatus

import anyio

from edge.core.event_log import Allowance
from edge.page.answers import NotAllowed

TRIES, TRY_EVERY_S = 5, 20.0  # of a password, by one address for one name: at once; at length [s]
TRIES_OF_ALL, TRIES_OF_ALL_S = 30, 1.0  # by all addresses for all names: each takes a quarter of a second
TRIERS_MAX = 1000  # that are remembered


@dataclass(slots=True)
class PasswordTries:
    """The tries so far. places : each check takes 16 MB, so thirty at once would end the page"""

    own: OrderedDict[str, Allowance] = field(default_factory=OrderedDict)
    everybodys: Allowance = field(
        default_factory=lambda: Allowance(TRIES_OF_ALL, 1.0 / TRIES_OF_ALL_S, time.monotonic)
    )
    places: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(1))

    def take(self, address: str, name: str) -> None:
        """Take one of the tries that an address has for a name. Errors: NotAllowed"""
        who = f"{address} {name}"
        tries = self.own.pop(who, None) or Allowance(TRIES, 1.0 / TRY_EVERY_S, time.monotonic)
        self.own[who] = tries
        if len(self.own) > TRIERS_MAX:
            self.own.popitem(last=False)
        if not (self.everybodys.take() and tries.take()):
            raise NotAllowed(HTTPStatus.TOO_MANY_REQUESTS, f"too many tries: wait {TRY_EVERY_S:g} s")
