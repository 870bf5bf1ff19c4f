"""Exchanges with one server elsewhere, in a thread: one at a time, each with an end."""

import asyncio
import logging
import threading
import traceback
from collections.abc import Callable
from typing import TypeVar

import anyio
import anyio.to_thread

from edge.core.errors import GreenhouseError
from edge.page.alarms.exchange import Cut, SendError

EXCHANGE_MAX_S = 30.0  # for all of an exchange, however slowly the server speaks
Result = TypeVar("Result")


class Sender:
    """Calls of one channel. A server that hangs has one thread of the page and no more."""

    def __init__(self) -> None:
        self._limiter = anyio.CapacityLimiter(1)
        self._busy = threading.Lock()

    async def run(self, call: Callable[[Cut], Result]) -> Result:
        """Return the result of a call that waits for the network. Errors: SendError"""
        cut = Cut()
        try:
            async with asyncio.timeout(EXCHANGE_MAX_S):
                return await anyio.to_thread.run_sync(
                    self._alone, call, cut, limiter=self._limiter, abandon_on_cancel=True
                )
        except TimeoutError:
            raise SendError(f"the exchange did not end within {EXCHANGE_MAX_S:g} s") from None
        finally:
            cut()  # also where the page ends: nobody waits for a slow server

    def _alone(self, call: Callable[[Cut], Result], cut: Cut) -> Result:
        if not self._busy.acquire(blocking=False):
            raise SendError("the exchange before hangs still")
        try:
            return call(cut)
        except SendError:
            raise
        except Exception as error:
            complain(error)  # a mistake of ours loses no alarm: it is tried again
            raise SendError(f"an error of the page itself: {type(error).__name__}, see its log") from None
        finally:
            self._busy.release()


def complain(error: Exception) -> None:
    """Write an error to the page's log; of a foreign one the place alone, as its text may be secret."""
    if isinstance(error, GreenhouseError):
        logging.getLogger(__name__).error("alarms: %s", error)
    else:
        place = "".join(traceback.format_tb(error.__traceback__))
        logging.getLogger(__name__).error("alarms: %s\n%s", type(error).__name__, place)
