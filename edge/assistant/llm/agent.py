"""The exchange with a model: messages out, tools called, until it answers. Every architecture uses it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from edge.assistant.llm.data_block import data_block
from edge.assistant.llm.endpoint import Endpoint
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.interrupt import Interrupt
from edge.assistant.llm.ledger import Ledger, Tool, ToolError
from edge.assistant.llm.wire import Message, Reply, Schema, ToolCall, Usage, assistant_message, tool_message
from edge.core.plain_text import plain
from edge.formats.reader import DocumentError, parse_json

CALLS_MAX = 8  # in one reply


@dataclass(slots=True)
class Conversation:
    """One question until its answer, and what became of it; read it also after a failure."""

    endpoint: Endpoint
    messages: list[Message]
    tools: Sequence[Tool] = ()
    temperature: float = 0.0
    schema: Schema | None = None
    ledger: Ledger = field(default_factory=Ledger)
    exchanges: int = 0
    waited_s: float = 0.0  # for the endpoint, its retries among it
    usage: Usage = field(default_factory=Usage)
    _mistakes: set[str] = field(default_factory=set)  # kinds that the model was told of once

    def run(self, deadline_s: float, stop: Interrupt) -> str | None:
        """Return the text of the model's last message.

        deadline_s : for all exchanges [s]
        Errors : LlmFailure; two mistakes of one kind in calling tools are a failure too
        """
        end_s = self.endpoint.now() + deadline_s
        most = self.endpoint.settings.exchanges
        while self.exchanges < most:
            reply = self._exchange(end_s - self.endpoint.now(), stop)
            if not reply.tool_calls:
                return reply.content
            self.messages.append(assistant_message(reply))
            for place, call in enumerate(reply.tool_calls):
                said = self._answer(call) if place < CALLS_MAX else _error("too many calls at once")
                self.messages.append(tool_message(call, said))
        raise LlmFailure("too_many_exchanges", f"no answer after {most}")

    def _exchange(self, deadline_s: float, stop: Interrupt) -> Reply:
        self.exchanges += 1
        # At the last one nothing is offered any more: what it knows by now must do.
        last = self.exchanges == self.endpoint.settings.exchanges
        specs = [] if last else [tool.spec for tool in self.tools]
        begun_s = self.endpoint.now()
        reply = self.endpoint.chat(self.messages, specs, self.temperature, self.schema, deadline_s, stop)
        self.waited_s += self.endpoint.now() - begun_s
        self.usage += reply.usage
        return reply

    def _answer(self, call: ToolCall) -> str:
        """Return the reply to the model's tool call."""
        tool = next((tool for tool in self.tools if tool.spec.name == call.name), None)
        if tool is None:
            self._mistake("unknown_tool", f"{plain(call.name, 40)!r}")
            known = ", ".join(tool.spec.name for tool in self.tools) or "none"
            return _error(f"there is no tool of this name; there are: {known}")
        try:
            arguments = parse_json(call.arguments, "arguments")
        except DocumentError as error:
            self._mistake("malformed", f"{call.name}: {error}")
            return _error(str(error))
        try:
            result = tool.call(arguments)
        except ToolError as error:
            self.ledger.errors += 1
            return _error(str(error))
        entry = self.ledger.record(call.name, arguments, result)
        return data_block(entry.id, {"id": entry.id, "result": result})

    def _mistake(self, kind: str, text: str) -> None:
        """Errors: LlmFailure at the second one of its kind."""
        self.ledger.errors += 1
        if kind in self._mistakes:
            raise LlmFailure(kind, f"{text}, again after it was told")
        self._mistakes.add(kind)


def _error(text: str) -> str:
    return data_block("error", {"error": text})
