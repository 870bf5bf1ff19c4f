"""edge/assistant/llm/controller.py: a thread may take its time, the tick does not wait for it."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from contexts import context
from llm_parts import ScriptedLine, language_model, says

from edge.app import controllers as registry
from edge.assistant.llm.claims import Claim
from edge.assistant.llm.controller import LlmController
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.language_model import LanguageModel
from edge.assistant.llm.line import Interrupt
from edge.assistant.llm.proposal import Architecture, ModelProposal
from edge.config.settings import ControlSettings
from edge.core.controller import Context
from edge.core.controller_names import LLM
from edge.core.errors import RequestError
from edge.core.messages import Command, Decision
from edge.models.arx_file import read_arx

SOON_S = 20.0  # of wall time: an answer that is to come in time does
AT_ONCE_S = 0.02
STEP_S = 60.0
FORECAST = (24.1, 24.2, 24.3)


class Thinking:
    """Gives the duty in `answers` in turn; waits for `release` first. A failure is raised."""

    def __init__(self, *answers: float | Exception) -> None:
        self.answers = list(answers)
        self.release = threading.Event()
        self.release.set()
        self.asked: list[float] = []
        self.stopped: list[Interrupt] = []
        self.flagged: tuple[Claim, ...] = ()

    def propose(self, model: LanguageModel, here: Context, stop: Interrupt) -> ModelProposal:
        self.asked.append(here.now_s)
        self.stopped.append(stop)
        answer = self.answers.pop(0)
        self.release.wait(SOON_S)
        if isinstance(answer, Exception):
            raise answer
        return ModelProposal(Command(heater_duty=answer), FORECAST, {"rationale": "so"}, self.flagged)


@pytest.fixture
def model(tmp_path: Path) -> Iterator[LanguageModel]:
    with language_model(tmp_path, ScriptedLine(says("hi")), answer_age_max_s=90.0) as made:
        yield made


Made = Callable[..., LlmController]


@pytest.fixture
def made(model: LanguageModel) -> Made:
    def make(thinking: Thinking, deadline_s: float = SOON_S, unequipped: str = "") -> LlmController:
        return LlmController("LLM-Te0", model, cast(Architecture, thinking), deadline_s, unequipped)

    return make


def at(controller: LlmController, minute: float) -> Decision:
    return controller.decide(context(now_s=STEP_S * minute))


def failure(controller: LlmController, minute: float) -> LlmFailure:
    with pytest.raises(LlmFailure) as caught:
        at(controller, minute)
    return caught.value


def settled(controller: LlmController) -> None:
    """Wait until the pending question is over."""
    question = controller._under_way
    assert question is not None and question.wait(SOON_S)


def after_its_tick(made: Made, *answers: float | Exception) -> tuple[LlmController, Thinking]:
    """A controller whose first answer has come too late; the next one will too."""
    thinking = Thinking(*answers)
    thinking.release.clear()
    controller = made(thinking, AT_ONCE_S)
    assert failure(controller, 0).kind == "late"
    thinking.release.set()
    settled(controller)
    thinking.release.clear()
    return controller, thinking


def test_an_answer_in_time_decides_this_tick(made: Made) -> None:
    decision = at(made(Thinking(0.45)), 0)
    assert decision.command == Command(heater_duty=0.45)
    assert (decision.controller, decision.forecast) == ("LLM-Te0", FORECAST)
    assert decision.why == {"rationale": "so", "asked_s_ago": 0.0, "failures": {}}


def test_every_tick_asks_anew(made: Made) -> None:
    thinking = Thinking(0.1, 0.2, 0.3)
    controller = made(thinking)
    assert [at(controller, minute).command.heater_duty for minute in range(3)] == [0.1, 0.2, 0.3]
    assert thinking.asked == [0.0, 60.0, 120.0]


def test_a_failure_is_raised_with_its_kind_and_the_counts(made: Made) -> None:
    controller = made(Thinking(LlmFailure("rate_limited", "status 429"), LlmFailure("refusal", "no"), 0.5))
    assert str(failure(controller, 0)) == "rate_limited: status 429 (so far: rate_limited 1)"
    assert str(failure(controller, 1)) == "refusal: no (so far: rate_limited 1, refusal 1)"
    assert at(controller, 2).why["failures"] == {"rate_limited": 1, "refusal": 1}


def test_whatever_breaks_in_the_thread_is_a_failure(made: Made) -> None:
    assert "broken: ZeroDivisionError: oops" in str(failure(made(Thinking(ZeroDivisionError("oops"))), 0))


def test_a_late_answer_serves_the_next_tick_once_and_says_how_old_it_is(made: Made) -> None:
    controller, thinking = after_its_tick(made, 0.1, 0.2, 0.3)
    decision = at(controller, 1)  # the question of minute 1 is under way meanwhile
    assert (decision.command.heater_duty, decision.why["asked_s_ago"]) == (0.1, 60.0)
    assert decision.forecast == FORECAST[1:]  # the first step has passed
    assert thinking.asked == [0.0, 60.0]
    assert failure(controller, 2).kind == "late"  # the answer to minute 0 was used, there is no other
    thinking.release.set()


def test_one_question_at_a_time(made: Made) -> None:
    thinking = Thinking(0.1, 0.2)
    thinking.release.clear()
    controller = made(thinking, AT_ONCE_S)
    for minute in (0.0, 0.5, 1.0, 1.5):
        assert failure(controller, minute).kind == "late"
    assert thinking.asked == [0.0]
    thinking.release.set()
    settled(controller)


@pytest.mark.parametrize(("minute", "used"), [(1.5, True), (1.51, False), (float("nan"), False)])
def test_an_answer_to_a_question_of_long_ago_is_not_used(made: Made, minute: float, used: bool) -> None:
    controller, thinking = after_its_tick(made, 0.1, 0.2)
    if used:
        assert at(controller, minute).command.heater_duty == 0.1
    else:
        assert failure(controller, minute).kind == "late"
    thinking.release.set()


def test_a_question_that_grew_old_is_interrupted_and_another_asked(made: Made) -> None:
    thinking = Thinking(0.1, 0.2, 0.3)
    thinking.release.clear()
    controller = made(thinking, AT_ONCE_S)
    failure(controller, 0)
    failure(controller, 2)
    assert thinking.stopped[0].fired
    assert thinking.asked == [0.0, 120.0]
    thinking.release.set()
    settled(controller)
    thinking.release.clear()
    assert at(controller, 3).command.heater_duty == 0.2  # and not the 0.1 of the first
    thinking.release.set()


def test_a_late_failure_is_told_at_the_next_tick(made: Made) -> None:
    controller, thinking = after_its_tick(made, LlmFailure("truncated", "cut"), 0.2)
    assert str(failure(controller, 1)) == "truncated: cut (so far: late 1, truncated 1)"
    thinking.release.set()


def test_a_reset_drops_what_is_under_way(made: Made) -> None:
    thinking = Thinking(0.1, 0.2)
    thinking.release.clear()
    controller = made(thinking, AT_ONCE_S)
    failure(controller, 0)
    controller.reset()
    assert thinking.stopped[0].fired
    thinking.release.set()
    controller._wait_s = SOON_S
    assert at(controller, 0.5).command.heater_duty == 0.2


def test_the_end_of_the_model_ends_its_threads(tmp_path: Path) -> None:
    before = set(threading.enumerate())
    thinking = Thinking(0.1)
    with language_model(tmp_path, ScriptedLine(says("hi"))) as model:
        controller = LlmController("LLM-Te0", model, cast(Architecture, thinking), SOON_S)
        at(controller, 0)
    assert [each for each in threading.enumerate() if each not in before] == []


def test_claims_that_do_not_hold_are_an_event(made: Made, model: LanguageModel) -> None:
    thinking = Thinking(0.1)
    thinking.flagged = (Claim("The fan is on.", "state", False, "the board confirmed heater 0.00, fan off"),)
    at(made(thinking), 0)
    (event,) = model.events_pending()
    assert event.key == "llm.claim"
    assert "'The fan is on.' (the board confirmed heater 0.00, fan off)" in event.text
    assert model.events_pending() == []


def test_what_is_missing_is_said_at_every_tick(made: Made) -> None:
    thinking = Thinking(0.1)
    controller = made(thinking, unequipped="there is no lstm in the active bundle")
    assert "unequipped: there is no lstm in the active bundle" in str(failure(controller, 0))
    assert thinking.asked == []


def parts(model: LanguageModel | None, **values: Any) -> registry.ControllerParts:
    return registry.ControllerParts(ControlSettings(), read_arx(), llm=model, **values)


@pytest.mark.parametrize("name", LLM)
def test_every_name_is_made(model: LanguageModel, name: str) -> None:
    controller = registry.make(name, parts(model, predictors={"lstm": read_arx(), "ham": read_arx()}))
    assert controller.name == name
    controller.reset()


@pytest.mark.parametrize("name", ["LLM-LSTM-Te0", "LLM-HAM-Te0-P"])
def test_a_predictor_that_the_bundle_lacks_is_named(model: LanguageModel, name: str) -> None:
    with pytest.raises(LlmFailure, match=r"unequipped: there is no (lstm|ham) in the active bundle"):
        registry.make(name, parts(model)).decide(context())


def test_without_a_language_model_there_is_no_such_controller() -> None:
    with pytest.raises(RequestError, match="no language model is configured"):
        registry.make("LLM-Te0", parts(None))
