"""A controller in a thread of its own, so that a slow or hanging one can't hold up the loop."""

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from edge.core.controller import Context, Controller
from edge.core.messages import Decision

SLICE_S = 0.1  # the longest that an emergency stop waits for a controller that thinks


@dataclass(frozen=True, slots=True)
class ThreadAnswer:
    """The outcome of one question: a decision, or the reason for its absence."""

    decision: Decision | None
    failure: str  # "" with a decision; else "late" or the exception's text
    wall_ms: float


class DecisionThread:
    """Asks controllers one question at a time. One that hangs costs this thread; a new one is begun."""

    def __init__(self, meanwhile: Callable[[], None] = lambda: None) -> None:
        self._meanwhile = meanwhile
        self._start()

    def ask(self, controller: Controller, context: Context, deadline_s: float) -> ThreadAnswer:
        """Return the controller's decision if it comes within `deadline_s` of wall time."""
        begun = time.perf_counter()
        questions, answers = self._questions, self._answers
        questions.put((controller, context))
        left_s = deadline_s
        while left_s > 0.0:
            left_s = begun + deadline_s - time.perf_counter()
            try:
                decision, failure = answers.get(timeout=max(0.0, min(SLICE_S, left_s)))
            except queue.Empty:
                self._meanwhile()
                continue
            return ThreadAnswer(decision, failure, 1e3 * (time.perf_counter() - begun))
        questions.put(None)  # ends the old thread if its controller ever comes back
        self._start()
        return ThreadAnswer(None, "late", 1e3 * (time.perf_counter() - begun))

    def close(self) -> None:
        """End the thread; one that hangs is a daemon thread and dies with the process."""
        self._questions.put(None)
        self._thread.join(timeout=1.0)

    def _start(self) -> None:
        self._questions: queue.SimpleQueue[tuple[Controller, Context] | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[tuple[Decision | None, str]] = queue.SimpleQueue()
        self._thread = threading.Thread(
            target=_answer, args=(self._questions, self._answers), name="decision", daemon=True
        )
        self._thread.start()


def _answer(
    questions: "queue.SimpleQueue[tuple[Controller, Context] | None]",
    answers: "queue.SimpleQueue[tuple[Decision | None, str]]",
) -> None:
    while (question := questions.get()) is not None:
        controller, context = question
        try:
            answers.put((controller.decide(context), ""))
        except Exception as error:  # whatever a controller does, the loop falls back to the next one
            answers.put((None, f"{type(error).__name__}: {error}"))
