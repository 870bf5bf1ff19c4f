"""One question of a controller, from prompt through tool calls to a checked proposal, in any architecture."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from edge.assistant.llm.answer import ModelAnswer, answer_schema, read_answer
from edge.assistant.llm.claims import Claim, KnownFacts, check_claims
from edge.assistant.llm.endpoint import Endpoint
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.language_model import LanguageModel
from edge.assistant.llm.ledger import AnsweredCall, Ledger, Tool, ToolError, data_block
from edge.assistant.llm.line import Interrupt
from edge.assistant.llm.prompts import question, system_prompt
from edge.assistant.llm.simulate_tool import NAME as SIMULATE
from edge.assistant.llm.simulate_tool import SimulateTool, Simulator, cited_forecast, first_controls
from edge.assistant.llm.sql_tool import SqlTool
from edge.assistant.llm.wire import (
    Message,
    Reply,
    Schema,
    ToolCall,
    Turn,
    Usage,
    assistant_message,
    tool_message,
)
from edge.core.controller import Context, Floats, goal_ahead
from edge.core.controller_names import LlmVariant
from edge.core.messages import Command
from edge.core.plain_text import plain
from edge.core.predictor import Predictor
from edge.formats.reader import DocumentError, parse_json

CALLS_MAX = 8  # in one reply
TRIES_MAX = 2  # of a first call, before an answer without one is let through


@dataclass(slots=True)
class Conversation:
    """One question until its answer, and what became of it; read it also after a failure."""

    endpoint: Endpoint
    messages: list[Message]
    tools: Sequence[Tool] = ()
    temperature: float = 0.0
    form: Callable[[Ledger], Schema | None] = lambda ledger: None  # of the answer, after the calls so far
    ledger: Ledger = field(default_factory=Ledger)
    exchanges: int = 0
    waited_s: float = 0.0  # for the endpoint, its retries among it
    usage: Usage = field(default_factory=Usage)
    _mistakes: set[str] = field(default_factory=set)  # kinds that the model was told of once
    _calls: set[tuple[str, str]] = field(default_factory=set)  # names and arguments
    _repeated: bool = False  # one of them came again

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

    def counts(self) -> dict[str, int]:
        """Return the sums so far: exchanges, tokens sent and received, calls answered and refused."""
        return {
            "exchanges": self.exchanges,
            "sent": self.usage.sent,
            "received": self.usage.received,
            "calls": len(self.ledger.entries),
            "calls_refused": self.ledger.errors,
        }

    def _exchange(self, deadline_s: float, stop: Interrupt) -> Reply:
        self.exchanges += 1
        specs = [tool.spec for tool in self.tools]
        begun_s = self.endpoint.now()
        schema, turn = self.form(self.ledger), self._turn()
        reply = self.endpoint.chat(self.messages, specs, self.temperature, schema, deadline_s, stop, turn)
        self.waited_s += self.endpoint.now() - begun_s
        self.usage += reply.usage
        return reply

    def _turn(self) -> Turn:
        """Return what is due: first a call; at the end, or after the same call again, the answer."""
        if self._repeated or self.exchanges == self.endpoint.settings.exchanges:
            return Turn.ANSWER
        first = not self.ledger.entries and self.ledger.errors < TRIES_MAX
        return Turn.CALL if first else Turn.EITHER

    def _answer(self, call: ToolCall) -> str:
        """Return the reply to the model's tool call."""
        self._repeated |= (call.name, call.arguments) in self._calls
        self._calls.add((call.name, call.arguments))
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
        return data_block(entry.id, {"id": entry.id, "result": tool.excerpt(result)})

    def _mistake(self, kind: str, text: str) -> None:
        """Errors: LlmFailure at the second one of its kind."""
        self.ledger.errors += 1
        if kind in self._mistakes:
            raise LlmFailure(kind, f"{text}, again after it was told")
        self._mistakes.add(kind)


def _error(text: str) -> str:
    return data_block("error", {"error": text})


QUERY_MAX = 300  # characters of a query that are kept
_ARCHITECTURES = {"": "simple", "sql": "sql"}


@dataclass(frozen=True, slots=True)
class ModelProposal:
    """A model's proposal after all checks but safety's."""

    command: Command
    forecast: tuple[float, ...]  # after each step from the question on [°C]; () without a simulation
    why: Mapping[str, Any]
    flagged: tuple[Claim, ...]  # claims that do not hold


@dataclass(frozen=True, slots=True)
class Architecture:
    """How a controller asks.

    predictor : for the variants that simulate, else None
    estimates : the predictor is the estimator's own model, whose offset it then takes
    horizon : longest simulated plan [steps]
    preview : the target of a simulation is the coming reference, not the present one
    """

    variant: LlmVariant
    predictor: Predictor | None
    estimates: bool
    horizon: int
    preview: bool

    def propose(self, model: LanguageModel, context: Context, stop: Interrupt) -> ModelProposal:
        """Ask and check. Errors: LlmFailure"""
        simulator = self._simulator(context)
        conversation = Conversation(
            endpoint=model.endpoint,
            messages=[
                {"role": "system", "content": system_prompt(self.variant, context, self.horizon)},
                {"role": "user", "content": question(self.variant, context)},
            ],
            tools=self._tools(model, context, simulator),
            temperature=self.variant.temperature,
            form=lambda ledger: answer_schema(None if simulator is None else first_controls(ledger)),
        )
        end = "answered"
        try:
            content = conversation.run(model.settings.answer_age_max_s, stop)
            answer = read_answer(content, simulator is not None)
            forecast = () if simulator is None else cited_forecast(answer, conversation.ledger, simulator)
        except LlmFailure as failure:
            end = failure.kind
            raise
        finally:
            model.count(conversation.counts() | {end: 1})
        claims = check_claims(answer.rationale, KnownFacts(context, conversation.ledger, answer.command))
        why = self._why(answer, conversation, model) | {"claims": [claim.to_json() for claim in claims]}
        return ModelProposal(
            answer.command, forecast, why, tuple(claim for claim in claims if not claim.holds)
        )

    def _simulator(self, context: Context) -> Simulator | None:
        if self.predictor is None:
            return None
        offset = context.estimate.offset if self.estimates else 0.0
        return Simulator(self.predictor, context, self.horizon, offset)

    def _tools(self, model: LanguageModel, context: Context, simulator: Simulator | None) -> list[Tool]:
        if simulator is not None:
            return [SimulateTool(simulator, self._targets(context))]
        return [SqlTool(model.history, model.utc)] if self.variant.assistance == "sql" else []

    def _targets(self, context: Context) -> Floats:
        return goal_ahead(context, self.horizon, self.preview)

    def _why(self, answer: ModelAnswer, conversation: Conversation, model: LanguageModel) -> dict[str, Any]:
        usage = conversation.usage
        why: dict[str, Any] = {
            "rationale": answer.rationale,
            "architecture": _ARCHITECTURES.get(self.variant.assistance, "prediction"),
            "language_model": model.settings.model,
            "exchanges": conversation.exchanges,
            "waited_ms": round(1e3 * conversation.waited_s, 3),
            "tool_calls": _in_short(conversation.ledger),
            "tokens": usage.sent + usage.received,
            "tokens_estimated": usage.estimated,
            "cost": model.budget.cost(usage),
        }
        if self.predictor is not None:
            why["model"] = f"{self.predictor.name} {self.predictor.version}"
            why["simulation"] = answer.simulation
        if answer.rounded_from is not None:
            why["rounded_from"] = answer.rounded_from
        return why


def _in_short(ledger: Ledger) -> list[dict[str, Any]]:
    """Return the calls in short for a history with a row a minute: the
    arguments, and one number of the result.
    """
    return [_simulation(entry) if entry.tool == SIMULATE else _query(entry) for entry in ledger.entries]


def _simulation(entry: AnsweredCall) -> dict[str, Any]:
    result = entry.result
    first = {"heater_duty": result["heater_duty"][0], "fan_on": result["fan_on"][0]}
    error_k = result["mean_abs_error_k"]
    return {"id": entry.id, **first, "steps": len(result["fan_on"]), "mean_abs_error_k": error_k}


def _query(entry: AnsweredCall) -> dict[str, Any]:
    query = plain(str(entry.arguments["query"]), QUERY_MAX)
    return {"id": entry.id, "query": query, "rows": entry.result["coverage"]["rows"]}
