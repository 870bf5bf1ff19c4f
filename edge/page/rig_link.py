"""The rig as the page sees it: the daemon's status once a second, its answers to orders, and the stop.

What is shown of outputs is what the board has echoed. While the daemon is silent the last status is old news
and says how old it is.
"""

import asyncio
import contextlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import anyio
import anyio.to_thread

from edge.core.errors import RequestError
from edge.core.hard_limits import LEASE_S
from edge.sockets.client import request
from edge.sockets.stop_file import LEFT, StopFile

Json = dict[str, Any]

WATCHED_S, UNWATCHED_S = 1.0, 5.0  # between two looks at the daemon, with and without somebody who looks
STATUS_MAX_S = 3.0
STOP_MAX_S = 2.0  # after which the daemon counts as one that does not answer
ANSWER_MAX_S = 15.0
QUESTIONS_MAX = 8  # under way; a stop has places of its own


class RigLink:
    """Asks the daemon at `socket`. Use `watch` as a task, beside everything else."""

    def __init__(self, socket: Path, stop_file: StopFile) -> None:
        self._socket, self._stop_file = socket, stop_file
        self._questions = anyio.CapacityLimiter(QUESTIONS_MAX)
        self._stops = anyio.CapacityLimiter(QUESTIONS_MAX)
        self._looks = anyio.CapacityLimiter(1)
        self._news = asyncio.Event()
        self._look_now = asyncio.Event()
        self._heard_s = float("-inf")
        self._status: Json | None = None
        self._why: Json = {}
        self._error = "the daemon has not been asked yet"
        self._stop_waits: Json | None = None  # who left a stop on the disk, and when
        self.viewers = 0

    def view(self) -> Json:
        """Return what is known now.

        reached : whether the daemon answered the last question; silent_s : since its last answer, null before
        the first; status : that answer; why : the newest tick's reasons; stop_waits : a stop that no daemon
        has taken yet; at_s : by a clock that never goes back, for views that overtake each other on their way
        """
        now_s = time.monotonic()
        silent_s = now_s - self._heard_s
        return {
            "at_s": round(now_s, 4),
            "reached": not self._error,
            "error": self._error,
            "silent_s": None if self._status is None else round(silent_s, 1),
            "lease_s": LEASE_S,
            "stop_waits": self._stop_waits,
            "status": self._status,
            "why": self._why,
            "utc": round(time.time(), 3),
        }

    async def next_news(self, at_most_s: float) -> None:
        """Wait for a change of the view."""
        news = self._news
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(at_most_s):
                await news.wait()

    async def watch(self) -> None:
        """Look at the daemon again and again; never ends."""
        while True:
            await self._look()
            self._look_now.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(WATCHED_S if self.viewers else UNWATCHED_S):
                    await self._look_now.wait()

    def look_now(self) -> None:
        """Have the daemon asked at once: somebody came, or an order was given."""
        self._look_now.set()

    async def ask(self, message: Mapping[str, Any]) -> Json:
        """Return the daemon's answer; one that does not come is an answer with the reason."""
        answer = await self._send(message, ANSWER_MAX_S, self._questions)
        self.look_now()
        return answer

    async def stop(self, author: str) -> Json:
        """Stop the rig, by the daemon or by the file that it will find: the latter "waits"."""
        answer = await self._send({"do": "emergency_stop", "by": author}, STOP_MAX_S, self._stops)
        if "operation" in answer or answer.get("ok"):
            self.look_now()
            return answer
        try:
            await anyio.to_thread.run_sync(self._stop_file.leave, author, limiter=self._stops)
        except OSError as error:
            return {"ok": False, "error": f"{answer['error']}; and no stop could be left: {error}"}
        self._stop_waits = {"by": author, "utc": round(time.time(), 3)}
        self._tell()
        self.look_now()
        return {"ok": True, "waits": True, "warning": LEFT}

    async def _send(
        self, message: Mapping[str, Any], at_most_s: float, places: anyio.CapacityLimiter
    ) -> Json:
        try:
            return await anyio.to_thread.run_sync(
                request, self._socket, message, at_most_s, limiter=places, abandon_on_cancel=True
            )
        except RequestError as error:
            return {"ok": False, "error": str(error), "unreached": True}

    async def _look(self) -> None:
        answer = await self._send({"do": "status"}, STATUS_MAX_S, self._looks)
        before = (self._status, self._error, self._stop_waits)
        if answer.get("ok"):
            await self._take(answer)
        else:
            self._error = str(answer.get("error", "the daemon gave no reason"))
        waits = await anyio.to_thread.run_sync(self._stop_file.author, limiter=self._looks)
        if waits is None:
            self._stop_waits = None
        elif self._stop_waits is None:
            self._stop_waits = {"by": waits, "utc": None}
        if before != (self._status, self._error, self._stop_waits):
            self._tell()

    async def _take(self, status: Json) -> None:
        seq = (status.get("tick") or {}).get("seq")
        if seq is not None and seq != self._why.get("seq"):
            found = await self._send({"do": "why"}, STATUS_MAX_S, self._looks)
            if found.get("ok"):
                self._why = {"seq": found["seq"], "lines": found["lines"]}
        self._status, self._error, self._heard_s = status, "", time.monotonic()

    def _tell(self) -> None:
        self._news.set()
        self._news = asyncio.Event()
