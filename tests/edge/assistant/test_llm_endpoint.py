"""llm/endpoint.py and wire.py: whatever a server does, an answer or a failure of a known kind."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from llm_parts import KEY, ScriptedLine, calls, document, endpoint, ok, says

from edge.assistant.llm.endpoint import retry_after_s
from edge.assistant.llm.failure import KINDS, LlmFailure
from edge.assistant.llm.line import HttpResponse, Interrupt
from edge.assistant.llm.wire import (
    Schema,
    ToolSpec,
    Turn,
    Usage,
    assistant_message,
    read_document,
    read_reply,
    read_usage,
    tool_message,
)

HELLO = [{"role": "user", "content": "hello"}]
SCHEMA = Schema("answer", {"type": "object"})
TOOL = ToolSpec("look", "looks", {"type": "object"})


def error(status: int, text: str = "no", after: str = "") -> HttpResponse:
    return HttpResponse(status, after, json.dumps({"error": {"message": text}}).encode())


def failure(folder: Path, line: ScriptedLine, deadline_s: float = 1000.0, **values: Any) -> LlmFailure:
    with endpoint(folder, line, **values) as made, pytest.raises(LlmFailure) as caught:
        made.chat(HELLO, deadline_s=deadline_s)
    assert caught.value.kind in KINDS
    return caught.value


def test_a_request_has_the_wire_format(tmp_path: Path) -> None:
    line = ScriptedLine(says("{}"))
    with endpoint(tmp_path, line) as made:
        reply = made.chat(HELLO, [TOOL], temperature=1.0, schema=SCHEMA, deadline_s=5.0)
        made.chat(HELLO, schema=SCHEMA)
    assert (reply.content, reply.finish_reason, reply.usage) == ("{}", "stop", Usage(100, 20))
    body = line.bodies[0]
    assert body["tools"] == [
        {
            "type": "function",
            "function": {"name": "look", "description": "looks", "parameters": {"type": "object"}},
        }
    ]
    assert body["parallel_tool_calls"] is False
    assert "response_format" not in body  # many servers can't do both
    assert (body["temperature"], body["max_tokens"], body["stream"]) == (1.0, 800, False)
    assert line.bodies[1]["response_format"] == {
        "type": "json_schema",
        "json_schema": {"name": "answer", "schema": {"type": "object"}, "strict": True},
    }
    assert line.headers[0]["Authorization"] == f"Bearer {KEY}"
    assert line.deadlines[0] == 5.0


@pytest.mark.parametrize(
    ("status", "kind", "asked"),
    [
        (429, "rate_limited", 3),
        (500, "server_error", 3),
        (503, "server_error", 3),
        (401, "refused_key", 1),
        (403, "refused_key", 1),
        (400, "bad_request", 1),
        (404, "bad_request", 1),
        (302, "bad_request", 1),
    ],
)
def test_every_status_is_a_kind_and_only_what_may_pass_is_tried_again(
    tmp_path: Path, status: int, kind: str, asked: int
) -> None:
    line = ScriptedLine(error(status))
    assert failure(tmp_path, line, retries=2).kind == kind
    assert len(line.bodies) == asked
    assert line.pauses == [1.0, 2.0][: asked - 1]


def test_a_server_that_recovers_is_answered(tmp_path: Path) -> None:
    line = ScriptedLine(error(500), LlmFailure("unreachable", "x"), says("hi"))
    with endpoint(tmp_path, line, retries=2) as made:
        assert made.chat(HELLO).content == "hi"


def test_a_server_that_cannot_be_reached_is_tried_again_after_the_shortest_pause(tmp_path: Path) -> None:
    line = ScriptedLine(LlmFailure("unreachable", "x"), says("hi"))
    with endpoint(tmp_path, line, backoff_s=0.25) as made:
        made.chat(HELLO)
    assert line.pauses == [0.25]


@pytest.mark.parametrize(("after", "pauses"), [("7", [7.0]), ("0.2", [1.0]), ("60", [60.0])])
def test_a_pause_is_as_long_as_the_server_asks(tmp_path: Path, after: str, pauses: list[float]) -> None:
    line = ScriptedLine(error(429, after=after), says("hi"))
    with endpoint(tmp_path, line) as made:
        made.chat(HELLO)
    assert line.pauses == pauses


@pytest.mark.parametrize("after", ["61", "-1", "nan", "inf", "Wed, 21 Oct 2026 07:28:00 GMT", "soon"])
def test_a_server_that_asks_for_too_much_patience_gets_none(tmp_path: Path, after: str) -> None:
    line = ScriptedLine(error(429, after=after))
    assert failure(tmp_path, line).kind == "rate_limited"
    assert line.pauses == []


def test_no_pause_reaches_beyond_the_deadline(tmp_path: Path) -> None:
    line = ScriptedLine(error(500))
    assert failure(tmp_path, line, deadline_s=3.5, retries=5).kind == "server_error"
    assert line.pauses == [1.0, 2.0]
    assert line.deadlines == [3.5, 2.5, 0.5]


@pytest.mark.parametrize("deadline_s", [0.0, -1.0, float("nan")])
def test_without_time_nothing_is_sent(tmp_path: Path, deadline_s: float) -> None:
    line = ScriptedLine(says("hi"))
    with endpoint(tmp_path, line) as made:
        with pytest.raises(LlmFailure, match="timeout"):
            made.chat(HELLO, deadline_s=deadline_s)
        assert made.budget.spent.tokens == 0
    assert line.bodies == []


def test_a_fired_interrupt_ends_the_retries(tmp_path: Path) -> None:
    stop, line = Interrupt(), ScriptedLine(error(500))
    stop.fire()
    with endpoint(tmp_path, line) as made, pytest.raises(LlmFailure, match="interrupted"):
        made.chat(HELLO, stop=stop)
    assert len(line.bodies) == 1


def test_a_server_without_response_format_is_asked_without_it_from_then_on(tmp_path: Path) -> None:
    no = error(400, "response_format is unknown")
    line = ScriptedLine(no, no, no, says("{}"))
    with endpoint(tmp_path, line) as made:
        assert made.chat(HELLO, schema=SCHEMA).content == "{}"
        made.chat(HELLO, schema=SCHEMA)
    assert ["response_format" in body for body in line.bodies] == [True, True, True, False, False]


@pytest.mark.parametrize("status", [400, 422, 500])
def test_a_server_that_knows_a_schema_in_another_place_is_found_out_once(tmp_path: Path, status: int) -> None:
    line = ScriptedLine(error(status, "Input should be 'text' or 'json_object'"), says("{}"))
    with endpoint(tmp_path, line) as made:
        assert made.chat(HELLO, schema=SCHEMA).content == "{}"
        made.chat(HELLO, schema=SCHEMA)
    assert [body["response_format"] for body in line.bodies[1:]] == [
        {"type": "json_object", "schema": {"type": "object"}}
    ] * 2
    assert line.pauses == []


def test_a_server_that_has_answered_is_not_thought_to_refuse_its_form_later(tmp_path: Path) -> None:
    line = ScriptedLine(says("{}"), error(500), error(400, "context too long"), says("{}"))
    with endpoint(tmp_path, line) as made:
        made.chat(HELLO, schema=SCHEMA)
        with pytest.raises(LlmFailure, match="context too long"):
            made.chat(HELLO, schema=SCHEMA)
        made.chat(HELLO, schema=SCHEMA)
    assert {body["response_format"]["type"] for body in line.bodies} == {"json_schema"}
    assert len(line.pauses) == 1


CALL = '{"tool": "look", "arguments": {"at": 3}}'


@pytest.mark.parametrize("first", [error(500, "tools: unknown"), error(400), says("I would look first.")])
def test_where_tools_are_not_spoken_natively_the_prompt_carries_them(
    tmp_path: Path, first: HttpResponse
) -> None:
    line = ScriptedLine(first, says(CALL), says("{}"))
    with endpoint(tmp_path, line) as made:
        reply = made.chat(HELLO, [TOOL], schema=SCHEMA)
        (call,) = reply.tool_calls
        assert (reply.content, call.name, call.arguments) == (None, "look", '{"at": 3}')
        told = [*HELLO, assistant_message(reply), tool_message(call, "<data>5</data>")]
        assert made.chat(told, [TOOL], schema=SCHEMA).content == "{}"
    asked = line.bodies[2]
    assert "tools" not in asked
    assert "- look: looks" in asked["messages"][0]["content"]
    assert [message["role"] for message in asked["messages"]] == ["system", "user", "assistant", "user"]
    assert json.loads(asked["messages"][2]["content"]) == json.loads(CALL)
    assert asked["messages"][3]["content"] == "<data>5</data>"
    call_form, answer_form = asked["response_format"]["json_schema"]["schema"]["anyOf"]
    assert call_form["properties"]["tool"] == {"const": "look"}
    assert answer_form == SCHEMA.schema


def test_the_form_admits_a_call_the_answer_or_either_as_it_is_asked(tmp_path: Path) -> None:
    line = ScriptedLine(error(400, "no tools"), says(CALL), says("{}"), says("{}"))
    with endpoint(tmp_path, line) as made:
        made.chat(HELLO, [TOOL], schema=SCHEMA, turn=Turn.CALL)
        made.chat(HELLO, [TOOL], schema=SCHEMA)
        made.chat(HELLO, [TOOL], schema=SCHEMA, turn=Turn.ANSWER)
    first, then, last = (body["response_format"]["json_schema"]["schema"] for body in line.bodies[1:])
    assert first["properties"]["tool"] == {"const": "look"}
    assert first in then["anyOf"]
    assert last == SCHEMA.schema
    # The prompt begins as before: a server need not read it again.
    assert line.bodies[3]["messages"] == line.bodies[2]["messages"]


def test_a_text_in_the_form_of_a_call_or_an_answer_ends(tmp_path: Path) -> None:
    given = {"type": "object", "properties": {"query": {"type": "string"}, "at": {"type": "integer"}}}
    tool, answer = ToolSpec("ask", "asks", given), Schema("answer", given)
    line = ScriptedLine(error(400, "no tools"), says('{"tool": "ask", "arguments": {}}'), says("{}"))
    with endpoint(tmp_path, line) as made:
        made.chat(HELLO, [tool], schema=answer, turn=Turn.CALL)
        made.chat(HELLO, [tool], schema=answer, turn=Turn.ANSWER)
    call, last = (body["response_format"]["json_schema"]["schema"] for body in line.bodies[1:])
    for form in (call["properties"]["arguments"], last):
        assert form["properties"] == {
            "query": {"type": "string", "maxLength": 240},
            "at": {"type": "integer"},
        }


def test_natively_spoken_tools_are_not_offered_when_the_answer_is_due(tmp_path: Path) -> None:
    line = ScriptedLine(calls("look", "{}"), says("{}"))
    with endpoint(tmp_path, line) as made:
        made.chat(HELLO, [TOOL], schema=SCHEMA)
        made.chat(HELLO, [TOOL], schema=SCHEMA, turn=Turn.ANSWER)
    assert ["tools" in body for body in line.bodies] == [True, False]


def test_a_server_with_tools_that_answers_in_words_is_asked_again_in_the_form(tmp_path: Path) -> None:
    line = ScriptedLine(calls("look", "{}"), says("Heat a little."), says("{}"))
    with endpoint(tmp_path, line) as made:
        assert made.chat(HELLO, [TOOL], schema=SCHEMA).tool_calls
        assert made.chat(HELLO, [TOOL], schema=SCHEMA).content == "{}"
    assert ["tools" in body for body in line.bodies] == [True, True, False]
    assert line.bodies[2]["response_format"]["type"] == "json_schema"


def test_a_server_that_wants_max_completion_tokens_gets_them(tmp_path: Path) -> None:
    line = ScriptedLine(error(400, "use 'max_completion_tokens' instead"), says("hi"))
    with endpoint(tmp_path, line) as made:
        made.chat(HELLO)
        made.chat(HELLO)
    assert ["max_completion_tokens" in body for body in line.bodies] == [False, True, True]


def test_a_request_that_is_refused_either_way_teaches_nothing(tmp_path: Path) -> None:
    line = ScriptedLine(*[error(400, "context too long")] * 4, says("{}"))
    with endpoint(tmp_path, line) as made:
        with pytest.raises(LlmFailure, match="bad_request"):
            made.chat(HELLO, schema=SCHEMA)
        made.chat(HELLO, schema=SCHEMA)
    assert line.bodies[4]["response_format"]["type"] == "json_schema"


def test_no_failure_tells_the_key(tmp_path: Path) -> None:
    for status in (400, 401, 403, 429, 500):
        line = ScriptedLine(error(status, f"bad key {KEY}", after="99"))
        assert KEY not in str(failure(tmp_path, line))
    with endpoint(tmp_path, ScriptedLine(says("hi"))) as made:
        assert KEY not in repr(made)


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        ({}, "malformed"),
        ({"choices": []}, "malformed"),
        ({"choices": [{"message": None}]}, "malformed"),
        (document({"content": 3}), "malformed"),
        (document({"content": None, "tool_calls": [{"id": "a"}]}), "malformed"),
        (document({"tool_calls": [{"id": "a", "function": {"name": "f", "arguments": {}}}]}), "malformed"),
        (document({"tool_calls": [{"id": 1, "function": {"name": "f", "arguments": ""}}]}), "malformed"),
        (document({"content": "{"}, "length"), "truncated"),
        (document({"content": ""}, "content_filter"), "refusal"),
        (document({"content": None, "refusal": "no"}), "refusal"),
    ],
)
def test_a_reply_of_another_form_is_a_failure_of_its_kind(tmp_path: Path, value: Any, kind: str) -> None:
    assert failure(tmp_path, ScriptedLine(ok(value))).kind == kind


@pytest.mark.parametrize("raw", [b"", b"\xff", b"null"])
def test_a_reply_that_is_no_json_object_is_malformed(tmp_path: Path, raw: bytes) -> None:
    assert failure(tmp_path, ScriptedLine(HttpResponse(200, "", raw))).kind == "malformed"


def test_content_may_be_null_and_arguments_no_json(tmp_path: Path) -> None:
    call = {"id": "a", "type": "function", "function": {"name": "f", "arguments": "{oops"}}
    line = ScriptedLine(ok(document({"content": None, "tool_calls": [call]}, "tool_calls")))
    with endpoint(tmp_path, line) as made:
        reply = made.chat(HELLO)
    assert reply.content is None
    assert reply.tool_calls[0].arguments == "{oops"


@pytest.mark.parametrize(
    "usage", [None, 3, {}, {"prompt_tokens": -1}, {"prompt_tokens": True}, {"prompt_tokens": 10**10}]
)
def test_a_count_that_cannot_be_is_none(usage: Any) -> None:
    assert read_usage({"usage": usage}) is None


@pytest.mark.parametrize("text", ["", "0", "3", "2.5"])
def test_seconds_of_a_header_are_read(text: str) -> None:
    assert retry_after_s(text) == float(text or 0)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
KEYS = ("content", "refusal", "tool_calls", "function", "id", "name", "arguments")
MESSAGES = st.dictionaries(st.sampled_from(KEYS), JSON)


@hypothesis_settings(suppress_health_check=[HealthCheck.too_slow])
@given(MESSAGES, JSON, st.sampled_from(["stop", "length", "tool_calls", "content_filter", None]))
def test_any_reply_is_read_or_refused(message: dict[str, Any], usage: Any, finish: str | None) -> None:
    whole = read_document(json.dumps(document(message, finish, usage)).encode())
    read_usage(whole)
    try:
        read_reply(whole, Usage())
    except LlmFailure as failure:
        assert failure.kind in KINDS
