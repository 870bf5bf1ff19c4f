"""edge/assistant/llm/prompts.py: the paper's question, the limits of this tick, the form of the answer."""

from dataclasses import replace

import pytest
from contexts import context

from edge.assistant.llm.prompts import EXACTLY, SPARE, question, system_prompt
from edge.core.controller import ControlLimits, Penalty
from edge.core.controller_names import LLM
from edge.core.messages import Command
from training.llm_stand_in.agent import read_prompt

HERE = context(temp=24.04, reference=26.0, last_sent=Command(0.45, True), limits=ControlLimits(0.62, 3))


@pytest.mark.parametrize("name", LLM)
def test_the_question_is_the_papers(name: str) -> None:
    asked = question(LLM[name], HERE)
    assert "maintain a temperature of 26.00 degrees? The temperature now is 24.04 and the ambient" in asked
    assert (EXACTLY in asked, SPARE in asked) == ((False, True) if name.endswith("-P") else (True, False))


@pytest.mark.parametrize("name", LLM)
def test_limits_and_form_are_told(name: str) -> None:
    told = system_prompt(LLM[name], HERE, 10)
    assert "heater_duty at most 0.62" in told
    assert "relay stays on for 3 more steps" in told
    assert "It is data" in told
    simulates = LLM[name].assistance not in ("", "sql")
    assert ('"simulation"' in told) is simulates
    assert ("tool simulate" in told) is simulates
    assert ("tool sql" in told) is (LLM[name].assistance == "sql")


def test_an_operators_weights_are_told() -> None:
    free = question(LLM["LLM-Te0"], HERE)
    dear = question(LLM["LLM-Te0"], replace(HERE, penalty=Penalty(heater=0.0, fan=5.0)))
    assert "operator" not in free
    assert "plus 0 times heater_duty squared plus 5 times 1 while the fan is on" in dear
    assert "squared plus" not in question(LLM["LLM-Te0"], replace(HERE, penalty=Penalty(fan=5.0)))


def test_a_free_relay_is_not_spoken_of() -> None:
    small = replace(HERE, limits=ControlLimits(heater_w=38.0))
    assert "(1 is 38 W)" in system_prompt(LLM["LLM-Te0"], small, 10)
    assert "relay stays" not in system_prompt(LLM["LLM-Te0"], replace(HERE, limits=ControlLimits()), 10)


@pytest.mark.parametrize(
    ("role", "words"), [("exhaust", "blows room air"), ("stirring", "lets none in"), ("none", "has no fan")]
)
def test_the_fan_is_this_boxes_own(role: str, words: str) -> None:
    here = replace(HERE, limits=ControlLimits(fan_role=role))
    assert words in system_prompt(LLM["LLM-Te0"], here, 10)


def test_a_script_reads_back_what_was_said() -> None:
    variant = LLM["LLM-HAM-Te0-P"]
    texts = (system_prompt(variant, HERE, 7), question(variant, HERE))
    asked = read_prompt([{"role": "user", "content": text} for text in texts])
    assert asked is not None
    assert (asked.target, asked.current, asked.ambient, asked.heater_max) == (26.0, 24.04, 21.0, 0.62)
    assert (asked.fan_on, asked.fan_held, asked.spare) == (True, True, True)
