"""llm/line.py, endpoint.py, wire.py, budget.py: whatever a server does, an answer or a known failure."""

import contextlib
import json
import math
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from certificates import make_certificates
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from llm_parts import KEY, UTC, ScriptedLine, calls, document, endpoint, ok, says, settings

from edge.assistant.llm.budget import Budget, Spending
from edge.assistant.llm.failure import KINDS, LlmFailure
from edge.assistant.llm.language_model import open_line
from edge.assistant.llm.line import HttpResponse, Interrupt, post
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
from edge.config.loading import default
from edge.config.settings import LlmSettings
from edge.core.errors import ConfigError
from edge.state.store import LLM_BUDGET, restore
from edge.state.writer import StateWriter
from training.llm_stand_in.server import StandIn

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


@pytest.mark.parametrize(("after", "pauses"), [("2.5", [2.5]), ("0.2", [1.0]), ("", [1.0]), ("60", [60.0])])
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


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
KEYS = ("content", "refusal", "tool_calls", "function", "id", "name", "arguments")
MESSAGES = st.dictionaries(st.sampled_from(KEYS), JSON)


@pytest.mark.slow
@hypothesis_settings(suppress_health_check=[HealthCheck.too_slow])
@given(MESSAGES, JSON, st.sampled_from(["stop", "length", "tool_calls", "content_filter", None]))
def test_any_reply_is_read_or_refused(message: dict[str, Any], usage: Any, finish: str | None) -> None:
    whole = read_document(json.dumps(document(message, finish, usage)).encode())
    read_usage(whole)
    try:
        read_reply(whole, Usage())
    except LlmFailure as failure:
        assert failure.kind in KINDS


DAY_S = 86400.0


class Days:
    """A budget that is restored from one file and saved to it, and the wall clock it goes by."""

    def __init__(self, folder: Path, **values: Any) -> None:
        self.utc = UTC
        place = replace(default(), state_file=str(folder / "state.json"))
        self.writer = StateWriter(LLM_BUDGET, place)
        spent = restore(LLM_BUDGET, place)
        self.budget = Budget(settings(**values), spent, self.writer.save, lambda: self.utc)

    def spend(self, most: Usage, used: Usage) -> None:
        self.budget.charge(most)
        self.budget.settle(most, used)


@pytest.fixture
def days(tmp_path: Path):
    made = Days(tmp_path, tokens_per_day=1000, price_in=2.0, price_out=10.0)
    yield made
    made.writer.close()


def test_what_was_used_counts_and_not_what_was_feared(days: Days) -> None:
    days.spend(Usage(100, 800), Usage(90, 20))
    spent = days.budget.spent
    assert (spent.tokens, spent.exchanges) == (110, 1)
    assert spent.cost == pytest.approx(90 * 2e-6 + 20 * 1e-5)


@pytest.mark.parametrize(("sent", "fits"), [(199, True), (200, True), (201, False)])
def test_nothing_is_sent_that_could_go_over_the_day(days: Days, sent: int, fits: bool) -> None:
    most = Usage(sent, 800)
    if fits:
        days.budget.charge(most)
    else:
        with pytest.raises(LlmFailure, match="over_budget: 0 of 1000 tokens"):
            days.budget.charge(most)


def test_two_who_ask_at_once_cannot_spend_the_same_tokens(days: Days) -> None:
    days.budget.charge(Usage(0, 600))
    with pytest.raises(LlmFailure, match="over_budget"):
        days.budget.charge(Usage(0, 600))


def test_money_is_a_limit_too(tmp_path: Path) -> None:
    days = Days(tmp_path, tokens_per_day=0, cost_per_day=0.01, price_out=10.0)
    days.spend(Usage(0, 900), Usage(0, 900))
    with pytest.raises(LlmFailure, match="over_budget"):
        days.budget.charge(Usage(0, 101))
    days.writer.close()


def test_a_new_utc_day_begins_at_nothing(days: Days) -> None:
    days.spend(Usage(900, 0), Usage(900, 0))
    days.utc += DAY_S - 1.0
    assert days.budget.spent.tokens == 900
    days.utc += 1.0
    assert days.budget.spent.tokens == 0
    days.budget.charge(Usage(900, 0))


def test_an_exchange_over_midnight_leaves_no_credit(days: Days) -> None:
    days.budget.charge(Usage(500, 0))
    days.utc += DAY_S
    days.budget.settle(Usage(500, 0), Usage())
    assert days.budget.spent.tokens == 0


def test_a_restart_goes_on_where_it_was(days: Days, tmp_path: Path) -> None:
    days.spend(Usage(900, 0), Usage(900, 0))
    days.writer.close()
    again = Days(tmp_path, tokens_per_day=1000)
    assert again.budget.spent.tokens == 900
    again.writer.close()


def test_a_spoilt_file_is_a_new_day(tmp_path: Path) -> None:
    (tmp_path / "llm_budget.json").write_text(
        '{"day": "2026-01-01", "tokens": -5, "cost": 0, "exchanges": 0}'
    )
    assert restore(LLM_BUDGET, replace(default(), state_file=str(tmp_path / "state.json"))) == Spending("")


@pytest.mark.parametrize(
    ("answer", "tokens"),
    [
        (says("hi"), 120),
        (says("hi", finish="length"), 120),
        (
            HttpResponse(
                500, "", json.dumps({"usage": {"prompt_tokens": 7, "completion_tokens": 0}}).encode()
            ),
            7,
        ),
        (HttpResponse(500, "", b"no"), 0),
        (LlmFailure("unreachable", "x"), 0),
    ],
)
def test_failed_exchanges_cost_what_the_server_counted(
    tmp_path: Path, answer: HttpResponse | LlmFailure, tokens: int
) -> None:
    with endpoint(tmp_path, ScriptedLine(answer), retries=0) as made:
        with contextlib.suppress(LlmFailure):
            made.chat(HELLO)
        assert made.budget.spent.tokens == tokens


@pytest.mark.parametrize(
    "answer", [says("hi", usage=None), LlmFailure("timeout", "x"), HttpResponse(200, "", b"{")]
)
def test_what_nobody_counted_is_estimated(tmp_path: Path, answer: HttpResponse | LlmFailure) -> None:
    with endpoint(tmp_path, ScriptedLine(answer)) as made:
        with contextlib.suppress(LlmFailure):
            assert made.chat(HELLO).usage.estimated
        assert 20 < made.budget.spent.tokens < 200  # four characters a token


def test_over_budget_nothing_goes_over_the_line(tmp_path: Path) -> None:
    line = ScriptedLine(says("hi"))
    with endpoint(tmp_path, line, tokens_per_day=700) as made, pytest.raises(LlmFailure, match="over_budget"):
        made.chat(HELLO)
    assert line.bodies == []


@pytest.mark.slow
@given(st.lists(st.tuples(*[st.integers(0, 2000)] * 4), max_size=8))
def test_a_day_never_goes_over_what_servers_keep_to(tmp_path_factory, exchanges) -> None:
    days = Days(tmp_path_factory.mktemp("budget"), tokens_per_day=3000)
    for sent, received, less_sent, less_received in exchanges:
        most = Usage(sent, received)
        with contextlib.suppress(LlmFailure):
            days.spend(most, Usage(min(sent, less_sent), min(received, less_received)))
        assert 0 <= days.budget.spent.tokens <= 3000
        assert math.isfinite(days.budget.spent.cost)
    days.writer.close()


BODY = b'{"messages": []}'


@pytest.fixture
def stand_in() -> Iterator[StandIn]:
    with StandIn() as server:
        yield server


def kind_of(stand_in: StandIn, behave: str, deadline_s: float = 20.0, stop: Interrupt | None = None) -> str:
    stand_in.behave = behave
    with pytest.raises(LlmFailure) as caught:
        post(f"{stand_in.url}/chat/completions", BODY, {}, deadline_s, stop or Interrupt())
    return caught.value.kind


def test_a_reply_comes_back_whole(stand_in: StandIn) -> None:
    stand_in.behave = "429"
    response = post(f"{stand_in.url}/chat/completions", BODY, {"X-Y": "z"}, 20.0, Interrupt())
    assert (response.status, response.retry_after) == (429, "20")
    assert b"Rate limit" in response.raw
    assert stand_in.headers[0]["X-Y"] == "z"


@pytest.mark.parametrize("behave", ["hanging", "dripping"])
def test_the_deadline_holds_for_the_whole_reply(stand_in: StandIn, behave: str) -> None:
    begun = time.monotonic()
    assert kind_of(stand_in, behave, deadline_s=0.3) == "timeout"
    assert time.monotonic() - begun < 10.0  # dripping it would take half a minute, hanging for ever


def test_a_reply_without_an_end_is_cut_off(stand_in: StandIn) -> None:
    assert kind_of(stand_in, "endless_reply") == "malformed"


def test_a_server_that_hangs_up_is_unreachable(stand_in: StandIn) -> None:
    assert kind_of(stand_in, "cut") == "unreachable"


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_certificates(tmp_path_factory.mktemp("certificates"))


def test_a_server_with_a_certificate_of_its_own_is_known_by_its_authority(certificates: Path) -> None:
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    tls.load_cert_chain(certificates / "broker.crt", certificates / "broker.key")
    with StandIn("429", tls=tls) as server:
        for ca, trusted in (("ca.crt", True), ("stranger.crt", False)):
            line = open_line(LlmSettings(url=server.url, model="m", ca=str(certificates / ca)))
            if trusted:
                assert line(f"{server.url}/chat/completions", BODY, {}, 20.0, Interrupt()).status == 429
            else:
                with pytest.raises(LlmFailure, match="unreachable: the line failed: SSLError"):
                    line(f"{server.url}/chat/completions", BODY, {}, 20.0, Interrupt())
        with pytest.raises(LlmFailure, match="SSLError"):
            post(f"{server.url}/chat/completions", BODY, {}, 20.0, Interrupt())


@pytest.mark.parametrize("content", [None, "no certificate"])
def test_an_authority_that_cannot_be_read_is_named(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "ca.crt").write_text(content)
    with pytest.raises(ConfigError, match=r"llm\.ca: .*ca\.crt"):
        open_line(LlmSettings(url="https://there/v1", model="m", ca=str(tmp_path / "ca.crt")))


def test_nobody_at_the_address_is_unreachable() -> None:
    with StandIn() as gone:
        url = gone.url
    with pytest.raises(LlmFailure, match="unreachable"):
        post(url, BODY, {}, 5.0, Interrupt())


def test_an_interrupt_from_another_thread_ends_a_read(stand_in: StandIn) -> None:
    stop = Interrupt()

    def fire() -> None:
        while not stand_in.requests:
            time.sleep(0.005)
        stop.fire()

    threading.Thread(target=fire).start()
    assert kind_of(stand_in, "hanging", stop=stop) == "interrupted"


def test_an_interrupt_that_was_fired_before_ends_it_at_once(stand_in: StandIn) -> None:
    stop = Interrupt()
    stop.fire()
    assert kind_of(stand_in, "hanging", stop=stop) == "interrupted"


def test_a_handshake_that_never_ends_ends_at_the_deadline() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        drip = threading.Thread(target=_drip, args=(silent,))
        drip.start()
        begun = time.monotonic()
        with pytest.raises(LlmFailure, match="timeout"):
            post(f"https://127.0.0.1:{silent.getsockname()[1]}/v1", BODY, {}, 0.3, Interrupt())
        assert time.monotonic() - begun < 10.0
        drip.join(20.0)
        assert not drip.is_alive()  # its client has hung up


def _drip(server: socket.socket) -> None:
    """Accept, and send the record of a handshake byte by byte: each one would restart a socket's timeout."""
    connection, _ = server.accept()
    with connection, suppress(OSError):
        for byte in b"\x16\x03\x03\x40\x00" + bytes(1000):
            connection.sendall(bytes([byte]))
            time.sleep(0.05)
