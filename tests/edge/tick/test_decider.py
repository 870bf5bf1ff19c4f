"""edge/tick/decider.py: a controller may be slow, hang or raise; the loop gets an answer in time."""

import threading
from typing import Any, cast

from edge.core.controller import Context
from edge.core.messages import Command, Decision
from edge.tick.decider import DecisionThread

CONTEXT = cast(Context, None)  # these controllers don't look


class Steady:
    name = "steady"

    def decide(self, context: Context) -> Decision:
        return Decision(Command(0.5), "steady")

    def reset(self) -> None: ...


class Raising(Steady):
    def decide(self, context: Context) -> Decision:
        raise ZeroDivisionError("no duty")


class Hanging(Steady):
    def __init__(self) -> None:
        self.release = threading.Event()

    def decide(self, context: Context) -> Decision:
        self.release.wait(timeout=30.0)
        return Decision(Command(1.0), "hanging")


def test_a_decision_comes_back_with_its_time() -> None:
    thread = DecisionThread()
    answer = thread.ask(Steady(), CONTEXT, 5.0)
    thread.close()
    assert answer.decision == Decision(Command(0.5), "steady")
    assert answer.failure == ""
    assert answer.wall_ms >= 0.0


def test_an_exception_comes_back_as_its_text() -> None:
    thread = DecisionThread()
    answer = thread.ask(Raising(), CONTEXT, 5.0)
    thread.close()
    assert answer.decision is None
    assert answer.failure == "ZeroDivisionError: no duty"


def test_a_hanging_controller_is_late_and_its_answer_never_taken_for_anothers() -> None:
    thread, hanging = DecisionThread(), Hanging()
    assert thread.ask(hanging, CONTEXT, 0.05).failure == "late"
    assert thread.ask(Steady(), CONTEXT, 5.0).decision == Decision(Command(0.5), "steady")
    hanging.release.set()
    assert thread.ask(Steady(), CONTEXT, 5.0).decision == Decision(Command(0.5), "steady")
    thread.close()


def test_threads_of_hanging_controllers_end_when_they_come_back() -> None:
    before = set(threading.enumerate())

    def deciding() -> list[Any]:
        return [each for each in threading.enumerate() if each not in before]

    thread, hanging = DecisionThread(), Hanging()
    thread.ask(hanging, CONTEXT, 0.05)
    hanging.release.set()
    thread.close()
    for each in deciding():
        each.join(timeout=5.0)
    assert deciding() == []
