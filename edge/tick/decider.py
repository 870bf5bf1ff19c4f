"""The decision of a step: the chosen controller in a thread of its own, else a fallback, else all outputs
off.
"""

import math
import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from edge.config.settings import ControlSettings
from edge.core.controller import Context, Controller
from edge.core.controller_names import RULES
from edge.core.messages import Command, Decision, Event, Severity
from edge.tick.faults import Conditions

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


ESTIMATE_AGE_MAX_S = 900.0  # after so long without a good air temperature a plan is a guess
FALLBACK_S = 1.0  # for each controller that decides instead
# A lease is renewed every 3 s and lasts 10 s: the chosen one's 4 s and 1 s of each fallback can't end one.
BLOCK_MAX_S = 4.0
FAILURES = ("controller.raised", "controller.not_a_number", "controller.late")


class Decider:
    """Asks, and notes in the conditions which row of the failure table holds."""

    def __init__(
        self,
        controllers: Mapping[str, Controller],
        settings: ControlSettings,
        conditions: Conditions,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """meanwhile : called again and again while a controller is waited for"""
        self._controllers = controllers
        self._fallbacks = (settings.fallback, RULES)
        self._deadline_s = decision_deadline_s(settings)
        self._conditions = conditions
        self._thread = DecisionThread(meanwhile)
        self._asked: set[str] = set()  # controllers that were asked at this tick
        self._asked_before: set[str] = set()  # and at the one before
        self._events: list[Event] = []

    def decide(self, chosen: str, context: Context) -> tuple[Decision, float]:
        """Return a decision with finite numbers, and the wall time it took [ms]."""
        self._asked_before, self._asked = self._asked, set()
        note, now, utc = self._conditions.set, context.now_s, context.utc
        old = not now - context.estimate.time_s <= ESTIMATE_AGE_MAX_S
        note("estimate.old", old, now, utc)
        if old:
            return _nobody("estimate.old"), 0.0
        decision, failure, wall_ms = self._ask(chosen, context, self._deadline_s)
        for key in FAILURES:
            note(key, key == failure, now, utc, chosen)
        if decision is not None:
            note("fallback.failed", False, now, utc)
            return decision, wall_ms
        also = failure
        for name in self._instead_of(chosen):
            decision, also, more_ms = self._ask(name, context, min(self._deadline_s, FALLBACK_S))
            wall_ms += more_ms
            if decision is not None:
                break
        note("fallback.failed", decision is None, now, utc, also)
        if decision is None:
            return _nobody(failure), wall_ms
        why = {**decision.why, "instead_of": chosen, "failure": failure}
        return replace(decision, why=why), wall_ms

    def take_events(self) -> list[Event]:
        """Return the controllers' events since the last call."""
        events, self._events = self._events, []
        return events

    def close(self) -> None:
        """End the decision thread; can be called twice."""
        self._thread.close()

    def _instead_of(self, chosen: str) -> list[str]:
        """In order; a rig without a model has no MPC to fall back to."""
        names = dict.fromkeys(self._fallbacks)
        return [name for name in names if name != chosen and name in self._controllers]

    def _ask(self, name: str, context: Context, deadline_s: float) -> tuple[Decision | None, str, float]:
        """One controller's decision, or the row of the failure table that holds; and the wall time [ms]."""
        controller = self._controllers.get(name)
        if controller is None:  # its model went with a bundle
            text = f"{name}: this rig has no such controller now"
            self._events.append(Event("controller.error", Severity.WARNING, text, context.now_s, context.utc))
            return None, "controller.raised", 0.0
        if name not in self._asked_before:
            controller.reset()
        self._asked.add(name)
        answer = self._thread.ask(controller, context, deadline_s)
        if answer.failure == "late":
            return None, "controller.late", answer.wall_ms
        if answer.decision is None:
            text = f"{name}: {answer.failure}"
            self._events.append(Event("controller.error", Severity.WARNING, text, context.now_s, context.utc))
            return None, "controller.raised", answer.wall_ms
        command = answer.decision.command
        if not all(map(math.isfinite, (command.heater_duty, command.led, command.valve_pulse_s))):
            return None, "controller.not_a_number", answer.wall_ms
        return answer.decision, "", answer.wall_ms


def decision_deadline_s(settings: ControlSettings) -> float:
    """How long the chosen controller may take [s of wall time]."""
    return min(settings.decision_deadline_s, settings.step_s / 2, BLOCK_MAX_S)


def _nobody(failure: str) -> Decision:
    return Decision(Command(), "none", why={"failure": failure})
