"""Who decides this step: the chosen controller, else the fallback, else nobody and nothing is on."""

import math
from collections.abc import Mapping
from dataclasses import replace

from edge.conditions import Conditions
from edge.controllers.base import Context, Controller
from edge.decision_thread import DecisionThread
from edge.messages import Command, Decision, Event, Severity
from edge.settings import ControlSettings

ESTIMATE_AGE_MAX_S = 900.0  # after so long without a good air temperature a plan is a guess
BLOCK_MAX_S = 5.0  # a lease is renewed every 3 s and lasts 10 s: a wait of 5 s can't end one
FAILURES = ("controller.raised", "controller.not_a_number", "controller.late")


class Decider:
    """Asks, and notes in the conditions which row of the failure table holds."""

    def __init__(
        self, controllers: Mapping[str, Controller], settings: ControlSettings, conditions: Conditions
    ) -> None:
        self._controllers = controllers
        self._fallback = settings.fallback
        self._deadline_s = min(settings.decision_deadline_s, settings.step_s / 2, BLOCK_MAX_S)
        self._conditions = conditions
        self._thread = DecisionThread()
        self._active = ""  # controller that was asked last
        self._events: list[Event] = []

    def decide(self, chosen: str, context: Context) -> tuple[Decision, float]:
        """A decision with finite numbers, and the wall time it took [ms]."""
        note, now, utc = self._conditions.set, context.now_s, context.utc
        old = not now - context.estimate.time_s <= ESTIMATE_AGE_MAX_S
        note("estimate.old", old, now, utc)
        if old:
            return _nobody("estimate.old"), 0.0
        decision, failure, wall_ms = self._ask(chosen, context)
        for key in FAILURES:
            note(key, key == failure, now, utc, chosen)
        if decision is not None:
            note("fallback.failed", False, now, utc)
            return decision, wall_ms
        decision, also, more_ms = self._ask(self._fallback, context)
        note("fallback.failed", decision is None, now, utc, also)
        if decision is None:
            return _nobody(failure), wall_ms + more_ms
        why = {**decision.why, "instead_of": chosen, "failure": failure}
        return replace(decision, why=why), wall_ms + more_ms

    def take_events(self) -> list[Event]:
        """What controllers raised since the last call."""
        events, self._events = self._events, []
        return events

    def close(self) -> None:
        """End the decision thread; can be called twice."""
        self._thread.close()

    def _ask(self, name: str, context: Context) -> tuple[Decision | None, str, float]:
        """One controller's decision, or the row of the failure table that holds; and the wall time [ms]."""
        controller = self._controllers[name]
        if name != self._active:
            controller.reset()
            self._active = name
        answer = self._thread.ask(controller, context, self._deadline_s)
        if answer.failure == "late":
            return None, "controller.late", answer.wall_ms
        if answer.decision is None:
            text = f"{name}: {answer.failure}"
            self._events.append(Event("controller.error", Severity.WARNING, text, context.now_s, context.utc))
            return None, "controller.raised", answer.wall_ms
        if not _is_finite(answer.decision.command):
            return None, "controller.not_a_number", answer.wall_ms
        return answer.decision, "", answer.wall_ms


def _nobody(failure: str) -> Decision:
    return Decision(Command(), "none", why={"failure": failure})


def _is_finite(command: Command) -> bool:
    return all(map(math.isfinite, (command.heater_duty, command.led, command.valve_pulse_s)))
