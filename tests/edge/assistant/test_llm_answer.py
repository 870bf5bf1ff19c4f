"""edge/assistant/llm/answer.py: one JSON object of one form, and nothing that a rig can't do."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.assistant.llm.answer import RATIONALE_MAX, answer_schema, nearest_level, read_answer
from edge.assistant.llm.failure import KINDS, LlmFailure
from edge.core.messages import Command

GOOD: dict[str, Any] = {"heater_duty": 0.45, "fan_on": False, "rationale": "warm enough"}


def kind_of(content: str | None, with_simulation: bool = False) -> str:
    with pytest.raises(LlmFailure) as caught:
        read_answer(content, with_simulation)
    return caught.value.kind


def text(**values: Any) -> str:
    return json.dumps({**GOOD, **values})


@pytest.mark.parametrize("wrap", ["{}", " \n{}\n", "```json\n{}\n```", "```\n{}\n```\n", "\n```json \n{}```"])
def test_one_object_alone_or_in_one_fence_is_an_answer(wrap: str) -> None:
    answer = read_answer(wrap.replace("{}", text()), False)
    assert (answer.command.heater_duty, answer.command.fan_on) == (0.45, False)
    assert answer.rationale == "warm enough"
    assert answer.rounded_from is None


@pytest.mark.parametrize(
    "content",
    [
        *(None, "", "  ", "hello", "[]", "3", "null", "{", "{}{}", "Sure! " + text(), text() + " Done."),
        *("```json\n" + text(), text().replace("0.45", "1e999")),
        "```json\n" + text() + "\n```\n```json\n" + text() + "\n```",
    ],
)
def test_anything_around_it_is_malformed(content: str | None) -> None:
    assert kind_of(content) == "malformed"


@pytest.mark.parametrize(
    "content",
    [
        *("{}", text(heater_duty="0.5"), text(fan_on=1), text(rationale=3), text(valve=1.0)),
        json.dumps({key: value for key, value in GOOD.items() if key != "rationale"}),
        text(simulation="simulate-1"),
    ],
)
def test_another_form_is_a_wrong_schema(content: str) -> None:
    assert kind_of(content) == "wrong_schema"


@pytest.mark.parametrize("duty", ["-0.01", "1.01", "40", "-1e-9", "1e300", "1" + "0" * 299])
def test_a_duty_that_the_heater_does_not_have_is_out_of_range(duty: str) -> None:
    assert kind_of(text().replace("0.45", duty)) == "out_of_range"


@pytest.mark.parametrize(("said", "duty"), [(0, 0.0), (1, 1.0), (1.0, 1.0), (0.05, 0.05), (0.4500004, 0.45)])
def test_levels_are_taken_as_they_are(said: float, duty: float) -> None:
    answer = read_answer(text(heater_duty=said), False)
    assert (answer.command.heater_duty, answer.rounded_from) == (duty, None)


@pytest.mark.parametrize(("said", "duty"), [(0.47, 0.45), (0.48, 0.5), (0.999, 1.0), (0.02, 0.0)])
def test_a_duty_between_levels_is_rounded_and_says_so(said: float, duty: float) -> None:
    answer = read_answer(text(heater_duty=said), False)
    assert (answer.command.heater_duty, answer.rounded_from) == (duty, said)


def test_a_long_rationale_is_cut_and_kept_on_one_line() -> None:
    answer = read_answer(text(rationale="a\nb\x1b[31m " + "x" * 5000), False)
    assert answer.rationale.startswith("a b [31m x")
    assert len(answer.rationale) == RATIONALE_MAX


def test_a_simulation_is_cited_where_there_are_any() -> None:
    assert read_answer(text(simulation="simulate-2"), True).simulation == "simulate-2"
    assert read_answer(text(), True).simulation == ""
    assert kind_of(text(simulation=2), True) == "wrong_schema"


def test_the_schema_asks_for_what_is_read() -> None:
    for with_simulation in (False, True):
        schema = answer_schema({} if with_simulation else None).schema
        assert schema["required"] == list(schema["properties"])
        values = {**GOOD, **({"simulation": "simulate-1"} if with_simulation else {})}
        assert values.keys() == schema["properties"].keys()
        read_answer(json.dumps(values), with_simulation)


def test_the_schema_names_every_level_and_the_simulations_that_there_are() -> None:
    levels = answer_schema(None).schema["properties"]["heater_duty"]["enum"]
    assert len(levels) == 21 and all(nearest_level(level) == level for level in levels)
    simulated = {"simulate-1": Command(0.5, False), "simulate-2": Command(0.2, False)}
    properties = answer_schema(simulated).schema["properties"]
    assert properties["simulation"]["enum"] == ["simulate-1", "simulate-2"]
    assert properties["heater_duty"]["enum"] == [0.2, 0.5]
    assert properties["fan_on"]["enum"] == [False]
    either = answer_schema({**simulated, "simulate-3": Command(0.5, True)}).schema["properties"]
    assert "enum" not in either["fan_on"]


def test_line_ends_inside_a_text_are_spaces() -> None:
    answer = read_answer('{"heater_duty": 0.45,\n"fan_on": false, "rationale": "warm\nand\tdry\x00"}', False)
    assert answer.rationale == "warm and dry"


@given(
    st.text(max_size=60)
    | st.dictionaries(st.sampled_from(list(GOOD)), st.floats() | st.text()).map(json.dumps)
)
def test_any_text_is_an_answer_or_a_failure_of_a_known_kind(content: str) -> None:
    try:
        answer = read_answer(content, False)
    except LlmFailure as failure:
        assert failure.kind in KINDS
    else:
        assert 0.0 <= answer.command.heater_duty <= 1.0


@given(st.floats(0.0, 1.0))
def test_the_nearest_level_is_one_the_board_has(duty: float) -> None:
    level = nearest_level(duty)
    assert abs(level - duty) <= 0.025 + 1e-12
    assert level in [step / 20 for step in range(21)]
