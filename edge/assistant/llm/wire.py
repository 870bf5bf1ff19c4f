"""Chat completions on the wire (OpenAI's openapi.yaml): a request's body, and a reply held to its form.

Servers differ: `content` may be null, `arguments` is a string that may be no JSON, usage may be missing.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeGuard

from edge.assistant.llm.failure import LlmFailure
from edge.core.plain_text import plain
from edge.formats.strict_json import parse_object

Message = Mapping[str, Any]
TOKENS_MAX = 10**9  # what a server says beyond this is no count
CHARACTERS_PER_TOKEN = 4  # of English text, by the vendors' rule of thumb


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


@dataclass(frozen=True, slots=True)
class Dialect:
    """The features that a server accepts beyond the common ones, learnt from its refusals."""

    response_format: bool = True
    tokens_key: str = "max_tokens"  # newer models of OpenAI's insist on max_completion_tokens

    def after_refusal(self, said: str) -> "Dialect | None":
        """Return the next dialect to try after a 400 with this text, None when none is left."""
        if "max_completion_tokens" in said and self.tokens_key == "max_tokens":
            return replace(self, tokens_key="max_completion_tokens")
        return replace(self, response_format=False) if self.response_format else None


@dataclass(frozen=True, slots=True)
class Chat:
    """One request, apart from the server's dialect."""

    model: str
    messages: Sequence[Message]
    answer_tokens: int
    tools: Sequence[ToolSpec] = ()
    temperature: float = 0.0
    schema: Schema | None = None

    def body(self, dialect: Dialect) -> dict[str, Any]:
        """As it is posted. A schema is sent only where no tools are: many servers can't do both."""
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
        elif self.schema is not None and dialect.response_format:
            described = {"name": self.schema.name, "schema": dict(self.schema.schema), "strict": True}
            body["response_format"] = {"type": "json_schema", "json_schema": described}
        return body


def _function(tool: ToolSpec) -> dict[str, Any]:
    return {"name": tool.name, "description": tool.description, "parameters": dict(tool.parameters)}


def estimated_tokens(text: str | bytes) -> int:
    """Tokens of a text, by its length."""
    return len(text) // CHARACTERS_PER_TOKEN + 1


def read_document(raw: bytes) -> dict[str, Any]:
    """Read the JSON object of a reply. Errors: LlmFailure, malformed"""
    try:
        return parse_object(raw)
    except ValueError as error:
        raise LlmFailure("malformed", f"the reply is no JSON object: {error}") from None


def read_usage(document: Mapping[str, Any]) -> Usage | None:
    """Read the token counts of a server, None where they are missing or impossible."""
    usage = document.get("usage")
    if not isinstance(usage, Mapping):
        return None
    sent, received = usage.get("prompt_tokens"), usage.get("completion_tokens", 0)
    return Usage(sent, received) if _is_count(sent) and _is_count(received) else None


def _is_count(value: object) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= TOKENS_MAX


def read_reply(document: Mapping[str, Any], usage: Usage) -> Reply:
    """Read the first choice. Errors: LlmFailure: malformed, truncated or refusal"""
    choices = document.get("choices")
    if not isinstance(choices, list) or not choices or not isinstance(choices[0], Mapping):
        raise LlmFailure("malformed", "the reply has no choices")
    message, finish = choices[0].get("message"), choices[0].get("finish_reason")
    if not isinstance(message, Mapping):
        raise LlmFailure("malformed", "choices[0].message is no object")
    if refusal := message.get("refusal"):
        raise LlmFailure("refusal", f"the model refuses: {plain(str(refusal))}")
    if finish == "content_filter":
        raise LlmFailure("refusal", "a content filter ended the answer")
    if finish == "length":
        raise LlmFailure("truncated", "the answer is longer than llm.answer_tokens")
    content = message.get("content")
    if not (content is None or isinstance(content, str)):
        raise LlmFailure("malformed", "choices[0].message.content is neither text nor null")
    return Reply(content, _tool_calls(message.get("tool_calls")), str(finish), usage)


def _tool_calls(calls: object) -> tuple[ToolCall, ...]:
    if calls is None:
        return ()
    if not isinstance(calls, list):
        raise LlmFailure("malformed", "choices[0].message.tool_calls is no list")
    return tuple(_tool_call(call, place) for place, call in enumerate(calls))


def _tool_call(call: object, place: int) -> ToolCall:
    function = call.get("function") if isinstance(call, Mapping) else None
    if not isinstance(call, Mapping) or not isinstance(function, Mapping):
        raise LlmFailure("malformed", f"tool_calls[{place}] has no function")
    found = (call.get("id"), function.get("name"), function.get("arguments"))
    if not all(isinstance(value, str) for value in found):
        raise LlmFailure("malformed", f"tool_calls[{place}]: id, name and arguments must be text")
    return ToolCall(*map(str, found))


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
