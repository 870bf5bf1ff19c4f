"""Requests from other threads (control socket, MQTT) to the control thread, and its answers."""

import os
import queue
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

Request = Mapping[str, Any]
Reply = dict[str, Any]

_STOPPING: Reply = {"ok": False, "error": "the daemon is stopping"}


@dataclass(frozen=True, slots=True)
class Letter:
    """One request on its way, with the place its answer goes to."""

    request: Request
    answer: "queue.SimpleQueue[Reply]" = field(default_factory=queue.SimpleQueue)


class Inbox:
    """A queue with a descriptor that wakes the control thread from its wait on the line."""

    def __init__(self) -> None:
        self._letters: queue.SimpleQueue[Letter] = queue.SimpleQueue()
        self._posting = threading.Lock()  # no letter comes in while it closes
        self._closed = False
        self.wake, self._ring = os.pipe()
        os.set_blocking(self.wake, False)
        os.set_blocking(self._ring, False)

    def ask(self, request: Request, timeout_s: float = 10.0) -> Reply:
        """Hand over a request and wait for its answer. Called from any thread but the control thread."""
        letter = Letter(request)
        with self._posting:
            if self._closed:
                return dict(_STOPPING)
            self._letters.put(letter)
            self.ring()
        try:
            return letter.answer.get(timeout=timeout_s)
        except queue.Empty:
            return {"ok": False, "error": f"the control loop did not answer within {timeout_s:g} s"}

    def ring(self) -> None:
        """Wake the control thread; safe in a signal handler."""
        try:
            os.write(self._ring, b"\0")
        except BlockingIOError:
            return  # the pipe is full: it is awake already

    def take(self) -> list[Letter]:
        """All letters that wait; clears the wake-up."""
        try:
            while os.read(self.wake, 512):
                pass
        except BlockingIOError:
            pass
        letters = []
        while True:
            try:
                letters.append(self._letters.get_nowait())
            except queue.Empty:
                return letters

    def close(self) -> None:
        """Nobody will answer any more: say so to all who wait and to all who come. Can be called twice."""
        with self._posting:
            if self._closed:
                return
            self._closed = True
            for letter in self.take():
                letter.answer.put(dict(_STOPPING))
            os.close(self.wake)
            os.close(self._ring)
