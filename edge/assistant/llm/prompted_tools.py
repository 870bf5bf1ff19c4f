"""Tools for servers that do not speak of them: the prompt describes them, and a call is an answer in JSON."""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.wire import Chat, Message, Reply, Schema, ToolCall, ToolSpec, Turn, read_object

TOOL, ARGUMENTS = "tool", "arguments"
TEXT_MAX = 240  # characters in a form: a small model's sentence goes on until its tokens are used up
_HEAD = (
    "You have tools. To use one, answer with one JSON object and nothing else: "
    f'{{"{TOOL}": <its name>, "{ARGUMENTS}": {{...}}}}. The next message holds its result. You may use tools '
    "several times; when you know enough, answer in the form that is asked for. The tools:"
)


def without_native_tools(chat: Chat) -> Chat:
    """Return a chat whose first message tells of its tools; earlier calls and results are plain texts."""
    messages = [_without_calls(message) for message in chat.messages]
    if not chat.tools:
        return replace(chat, messages=messages)
    described = "\n".join([_HEAD, *map(_describe, chat.tools)])
    if messages and messages[0]["role"] == "system":
        described = f"{messages.pop(0)['content']}\n\n{described}"
    schema = _with_calls(chat)
    messages.insert(0, {"role": "system", "content": described})
    return replace(chat, messages=messages, tools=(), schema=schema)


def _with_calls(chat: Chat) -> Schema | None:
    """Return the schema of a call of a tool, of the answer, or of either, as it is asked for."""
    if chat.schema is None:
        return None
    answer = _with_ends(chat.schema.schema)
    if chat.turn is Turn.ANSWER:
        return Schema(chat.schema.name, answer)
    calls = [
        {
            "type": "object",
            "properties": {TOOL: {"const": tool.name}, ARGUMENTS: _with_ends(tool.parameters)},
            "required": [TOOL, ARGUMENTS],
            "additionalProperties": False,
        }
        for tool in chat.tools
    ]
    forms = calls if chat.turn is Turn.CALL else [*calls, answer]
    return Schema(chat.schema.name, forms[0] if len(forms) == 1 else {"anyOf": forms})


def _with_ends(schema: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of an object whose texts end."""
    properties = {
        name: {"maxLength": TEXT_MAX, **own} if own.get("type") == "string" else own
        for name, own in schema.get("properties", {}).items()
    }
    return {**schema, "properties": properties} if properties else dict(schema)


def read_call(reply: Reply) -> Reply:
    """Return the reply with its content as a call of a tool, where it is one."""
    try:
        found = read_object(reply.content)
    except LlmFailure:
        return reply
    if not isinstance(found.get(TOOL), str):
        return reply
    call = ToolCall("call-1", found[TOOL], json.dumps(found.get(ARGUMENTS, {})))
    return replace(reply, content=None, tool_calls=(call,))


def _describe(tool: ToolSpec) -> str:
    return f"- {tool.name}: {tool.description} Its arguments by JSON schema: {json.dumps(tool.parameters)}"


def _without_calls(message: Message) -> Message:
    if message["role"] == "tool":
        return {"role": "user", "content": message["content"]}
    if calls := message.get("tool_calls"):
        return {"role": "assistant", "content": "\n".join(map(_call_text, calls))}
    return message


def _call_text(call: Mapping[str, Any]) -> str:
    function = call["function"]
    return f'{{"{TOOL}": {json.dumps(function["name"])}, "{ARGUMENTS}": {function["arguments"]}}}'
