"""Requests from other threads (control socket, MQTT) to the control thread, and its answers.

Three lanes: emergency stop before maintenance before everything else. Within a lane requests are served in
their order. A stop, maintenance or status that repeats the newest waiting request shares its answer.
"""

import os
import queue
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from edge.tick.status import reply_json

Request = Mapping[str, Any]
Reply = dict[str, Any]

STOP, MAINTENANCE, ORDINARY = range(3)
LANES = {"emergency_stop": STOP, "maintenance": MAINTENANCE}
WAITING_MAX = 32  # requests in a lane; a stop always finds room: each door keeps only a few under way
_SHARED = (*LANES, "status")  # two of these in a row do the same as one

_STOPPING: Reply = {"ok": False, "error": "the daemon is stopping"}
_BUSY: Reply = {"ok": False, "error": f"busy: {WAITING_MAX} requests wait already"}
_OVERTAKEN: Reply = {"ok": False, "error": "an emergency stop was given after this release"}


def is_in_force(reply: Reply) -> bool:
    """Return whether an order was carried out, even where the disk has not taken it."""
    return "operation" in reply or reply.get("ok") is True


@dataclass(frozen=True, slots=True)
class _Answers:
    """The places of all who sent one request."""

    places: list[Callable[[Reply], None]]

    def put(self, reply: Reply, /) -> None:
        for place in self.places:
            place(dict(reply))


@dataclass(frozen=True, slots=True)
class Letter:
    """One request on its way, with the place its answer goes to."""

    request: Request
    answer: _Answers = field(default_factory=lambda: _Answers([]))


class Inbox:
    """Lanes with a descriptor that wakes the control thread from its wait on the line."""

    def __init__(self) -> None:
        self._lanes: tuple[deque[tuple[Request, _Answers]], ...] = (deque(), deque(), deque())
        self._posting = threading.Lock()
        self._closed = False
        self.wake, self._ring = os.pipe()
        os.set_blocking(self.wake, False)
        os.set_blocking(self._ring, False)

    def ask(self, request: Request, timeout_s: float = 10.0) -> Reply:
        """Hand over a request and wait for its answer, as JSON values.

        Called from any thread but the control thread.
        """
        answer: queue.SimpleQueue[Reply] = queue.SimpleQueue()
        self.post(request, answer.put)
        try:
            return reply_json(answer.get(timeout=timeout_s))
        except queue.Empty:
            return {"ok": False, "error": f"the control loop did not answer within {timeout_s:g} s"}

    def post(self, request: Request, answered: Callable[[Reply], None]) -> None:
        """Hand over a request without waiting; `answered` is called once, from any thread.

        The answer's status is not encoded yet, see `edge.tick.status.reply_json`.
        """
        refused: list[_Answers] = []
        with self._posting:
            if self._closed:
                reply = _STOPPING
                refused.append(_Answers([answered]))
            elif not self._take_in(request, answered):
                reply = _BUSY
                refused.append(_Answers([answered]))
            else:
                reply = _OVERTAKEN
                refused += self._overtaken_by(request)
                self.ring()
        for answers in refused:
            answers.put(reply)

    def ring(self) -> None:
        """Wake the control thread; safe in a signal handler."""
        try:
            os.write(self._ring, b"\0")
        except BlockingIOError:
            return  # the pipe is full: it is awake already

    def take(self, lanes: int = ORDINARY + 1) -> Letter | None:
        """Return the next letter of the first `lanes` lanes; clear the wake-up when none is left."""
        with self._posting:
            lane = next((lane for lane in self._lanes[:lanes] if lane), None)
            letter = None if lane is None else Letter(*lane.popleft())
            if not any(self._lanes) and not self._closed:
                self._hush()
            return letter

    def close(self) -> None:
        """Nobody will answer any more: say so to all who wait and to all who come. Can be called twice."""
        with self._posting:
            if self._closed:
                return
            self._closed = True
            waiting = [answers for lane in self._lanes for _, answers in lane]
            for lane in self._lanes:
                lane.clear()
            os.close(self.wake)
            os.close(self._ring)
        for answers in waiting:
            answers.put(_STOPPING)

    def _take_in(self, request: Request, answered: Callable[[Reply], None]) -> bool:
        number = _lane(request)
        lane = self._lanes[number]
        if lane and lane[-1][0] == request and request.get("do") in _SHARED:
            lane[-1][1].places.append(answered)
            return True
        if number != STOP and len(lane) >= WAITING_MAX:
            return False
        lane.append((request, _Answers([answered])))
        return True

    def _overtaken_by(self, request: Request) -> list[_Answers]:
        """Return earlier releases, which a stop overtakes: they must not end the stop afterwards."""
        if _lane(request) != STOP:
            return []
        lane = self._lanes[ORDINARY]
        releases = [letter for letter in lane if letter[0].get("do") == "release_emergency_stop"]
        for letter in releases:
            lane.remove(letter)
        return [answers for _, answers in releases]

    def _hush(self) -> None:
        try:
            while os.read(self.wake, 512):
                pass
        except BlockingIOError:
            pass


def is_urgent(request: Request) -> bool:
    """Emergency stop and maintenance, which do not wait behind other requests."""
    return _lane(request) != ORDINARY


def _lane(request: Request) -> int:
    what = request.get("do")
    return LANES.get(what, ORDINARY) if isinstance(what, str) else ORDINARY
