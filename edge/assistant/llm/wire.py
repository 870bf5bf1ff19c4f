"""Chat completions on the wire (OpenAI's openapi.yaml): a request's body, and a reply held to its form.

Servers differ: `content` may be null, `arguments` is a string that may be no JSON, usage may be missing.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any

from edge.assistant.llm.dialect import AnswerForm, Dialect
from edge.assistant.llm.failure import LlmFailure
from edge.core.plain_text import plain
from edge.formats.cross_check import Rule
from edge.formats.reader import DocumentError, Foreign, parse_json, read

Message = Mapping[str, Any]
TOKENS_MAX = 10**9  # what a server says beyond this is no count
Count = Annotated[int, Rule(low=0, high=TOKENS_MAX)]
CHARACTERS_PER_TOKEN = 4  # of English text, by the vendors' rule of thumb
# Line ends inside a string are no JSON, but grammars of servers let models write them.
_ON_ONE_LINE = {code: " " for code in range(0x20)}
_FENCED = re.compile(r"\s*```(?:json)?\s*\n(?P<json>.*?)\n?\s*```\s*", re.DOTALL)


@dataclass(frozen=True, slots=True)
class ToolSpec:
    """A tool as it is offered; `parameters` is a JSON schema."""

    name: str  # up to 64 of a-zA-Z0-9_-
    description: str
    parameters: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Schema:
    """The JSON schema an answer shall follow."""

    name: str
    schema: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ToolCall:
    """A call the model asks for; `arguments` as it came: a string that may be no JSON."""

    id: str
    name: str
    arguments: str


@dataclass(frozen=True, slots=True)
class Usage:
    """Tokens of one or more exchanges."""

    sent: int = 0
    received: int = 0
    estimated: bool = False  # the server did not count them

    def __add__(self, other: "Usage") -> "Usage":
        return Usage(
            self.sent + other.sent, self.received + other.received, self.estimated or other.estimated
        )


@dataclass(frozen=True, slots=True)
class Reply:
    """One reply: text, tool calls or both."""

    content: str | None
    tool_calls: tuple[ToolCall, ...]
    finish_reason: str
    usage: Usage


class Turn(Enum):
    """The kinds of reply that are asked for while tools are offered."""

    EITHER = "a call of a tool or the answer"
    CALL = "a call"
    ANSWER = "the answer"


@dataclass(frozen=True, slots=True)
class Chat:
    """One request, apart from the server's dialect."""

    model: str
    messages: Sequence[Message]
    answer_tokens: int
    tools: Sequence[ToolSpec] = ()
    temperature: float = 0.0
    schema: Schema | None = None
    turn: Turn = Turn.EITHER

    def uses(self, dialect: Dialect) -> frozenset[str]:
        """Return the parts of a request that a server may refuse."""
        if self.tools and dialect.native_tools:
            return frozenset({dialect.tokens_key, "tools"})
        return frozenset({dialect.tokens_key, dialect.form.value if self.schema else ""})

    def body(self, dialect: Dialect) -> dict[str, Any]:
        """As it is posted. Beside native tools no form is asked for: many servers can't do both."""
        body: dict[str, Any] = {
            "model": self.model,
            "messages": list(self.messages),
            "temperature": self.temperature,
            dialect.tokens_key: self.answer_tokens,
            "stream": False,
        }
        if self.tools:
            body["tools"] = [{"type": "function", "function": _function(tool)} for tool in self.tools]
            body["parallel_tool_calls"] = False
        elif self.schema is not None and dialect.form is not AnswerForm.FREE:
            body["response_format"] = _response_format(self.schema, dialect.form)
        return body


def _response_format(schema: Schema, form: AnswerForm) -> dict[str, Any]:
    if form is AnswerForm.SCHEMA:
        described = {"name": schema.name, "schema": dict(schema.schema), "strict": True}
        return {"type": "json_schema", "json_schema": described}
    if form is AnswerForm.OBJECT_BY_SCHEMA:
        return {"type": "json_object", "schema": dict(schema.schema)}
    return {"type": "json_object"}


def _function(tool: ToolSpec) -> dict[str, Any]:
    return {"name": tool.name, "description": tool.description, "parameters": dict(tool.parameters)}


def estimated_tokens(text: str | bytes) -> int:
    """Tokens of a text, by its length."""
    return len(text) // CHARACTERS_PER_TOKEN + 1


@dataclass(frozen=True, slots=True)
class UsageDocument(Foreign):
    """Tokens as a server counts them."""

    prompt_tokens: Count
    completion_tokens: Count = 0


@dataclass(frozen=True, slots=True)
class CalledFunction(Foreign):
    """The function and arguments of a call."""

    name: str
    arguments: str


@dataclass(frozen=True, slots=True)
class CallDocument(Foreign):
    """A call as a server passes it on."""

    id: str
    function: CalledFunction


@dataclass(frozen=True, slots=True)
class ChoiceMessage(Foreign):
    """Text or calls of the model."""

    content: str | None = None
    tool_calls: tuple[CallDocument, ...] | None = None
    refusal: Any = None


@dataclass(frozen=True, slots=True)
class ReplyChoice(Foreign):
    """One answer of the model."""

    message: ChoiceMessage
    finish_reason: Any = None


@dataclass(frozen=True, slots=True)
class ChoicesDocument(Foreign):
    """A server's reply."""

    choices: Annotated[tuple[ReplyChoice, ...], Rule(least=1)]


def read_document(raw: bytes) -> dict[str, Any]:
    """Read the JSON object of a reply. Errors: LlmFailure, malformed"""
    try:
        return parse_json(raw, "the reply")
    except DocumentError as error:
        raise LlmFailure("malformed", str(error)) from None


def read_usage(document: Mapping[str, Any]) -> Usage | None:
    """Read the token counts of a server, None where they are missing or impossible."""
    try:
        usage = read(UsageDocument, document.get("usage"))
    except DocumentError:
        return None
    return Usage(usage.prompt_tokens, usage.completion_tokens)


def read_reply(document: Mapping[str, Any], usage: Usage) -> Reply:
    """Read the first choice. Errors: LlmFailure: malformed, truncated or refusal"""
    try:
        choice = read(ChoicesDocument, document).choices[0]
    except DocumentError as error:
        raise LlmFailure("malformed", str(error)) from None
    if refusal := choice.message.refusal:
        raise LlmFailure("refusal", f"the model refuses: {plain(str(refusal))}")
    if choice.finish_reason == "content_filter":
        raise LlmFailure("refusal", "a content filter ended the answer")
    if choice.finish_reason == "length":
        raise LlmFailure("truncated", "the answer is longer than llm.answer_tokens")
    calls = choice.message.tool_calls or ()
    return Reply(
        choice.message.content,
        tuple(ToolCall(call.id, call.function.name, call.function.arguments) for call in calls),
        str(choice.finish_reason),
        usage,
    )


def read_object(content: str | None) -> Mapping[str, Any]:
    """One JSON object, alone or in one fence. Errors: LlmFailure: malformed"""
    if content is None or not content.strip():
        raise LlmFailure("malformed", "the answer is empty")
    fenced = _FENCED.fullmatch(content)
    text = fenced["json"] if fenced else content
    try:
        return parse_json(text.translate(_ON_ONE_LINE), "the answer")
    except DocumentError as error:
        raise LlmFailure("malformed", str(error)) from None


def assistant_message(reply: Reply) -> dict[str, Any]:
    """Return the model's own message, to be sent back before the results of its calls."""
    message: dict[str, Any] = {"role": "assistant", "content": reply.content}
    if reply.tool_calls:
        message["tool_calls"] = [
            {"id": call.id, "type": "function", "function": {"name": call.name, "arguments": call.arguments}}
            for call in reply.tool_calls
        ]
    return message


def tool_message(call: ToolCall, content: str) -> dict[str, Any]:
    """Return the message with one call's result."""
    return {"role": "tool", "tool_call_id": call.id, "content": content}


def to_bytes(body: Mapping[str, Any]) -> bytes:
    """JSON; NaN is refused here and not by the server. Errors: ValueError"""
    return json.dumps(body, allow_nan=False).encode()
