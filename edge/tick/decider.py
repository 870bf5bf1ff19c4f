"""Who decides this step: the chosen controller, else a fallback, else nobody and nothing is on."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from edge.config.settings import ControlSettings
from edge.core.controller import Context, Controller
from edge.core.controller_names import RULES
from edge.core.messages import Command, Decision, Event, Severity
from edge.tick.conditions import Conditions
from edge.tick.decision_thread import DecisionThread

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
        if not _is_finite(answer.decision.command):
            return None, "controller.not_a_number", answer.wall_ms
        return answer.decision, "", answer.wall_ms


def decision_deadline_s(settings: ControlSettings) -> float:
    """How long the chosen controller may take [s of wall time]."""
    return min(settings.decision_deadline_s, settings.step_s / 2, BLOCK_MAX_S)


def _nobody(failure: str) -> Decision:
    return Decision(Command(), "none", why={"failure": failure})


def _is_finite(command: Command) -> bool:
    return all(map(math.isfinite, (command.heater_duty, command.led, command.valve_pulse_s)))
