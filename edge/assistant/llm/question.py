"""A question to a model that is answered in a thread of its own; nobody has to wait for it."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.line import Interrupt

T = TypeVar("T")
END_S = 2.0  # how long the end of a thread is waited for; one that hangs is a daemon thread


class Question(Generic[T]):
    """Under way from its making on.

    work : gives the answer or raises, and ends soon after its interrupt is fired
    asked_s : the asker's time [s]
    """

    def __init__(self, work: Callable[[Interrupt], T], asked_s: float) -> None:
        self.asked_s = asked_s
        self._work = work
        self._stop = Interrupt()
        self._done = threading.Event()
        self._answer: T | None = None
        self._failure: LlmFailure | None = None
        self._thread = threading.Thread(target=self._run, name="language-model", daemon=True)
        self._thread.start()

    def wait(self, seconds: float) -> bool:
        """Wait at most so long; return whether the question is over."""
        return self._done.wait(seconds)

    def answer(self) -> T:
        """Return the answer of a question that is over. Errors: LlmFailure"""
        if self._failure is not None:
            raise self._failure
        assert self._answer is not None
        return self._answer

    def drop(self) -> None:
        """Nobody wants the answer any more. Does not wait."""
        self._stop.fire()

    def close(self) -> None:
        """Drop it, and see its thread end."""
        self.drop()
        self._thread.join(END_S)

    def _run(self) -> None:
        try:
            self._answer = self._work(self._stop)
        except LlmFailure as failure:
            self._failure = failure
        except Exception as error:  # of any part of the work; the asker's fallback decides then
            self._failure = LlmFailure("broken", f"{type(error).__name__}: {error}")
        finally:
            self._stop.let_go()
            self._done.set()
