"""One question of a controller from prompt to checked proposal, in any of the three architectures."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from edge.assistant.llm.agent import Conversation
from edge.assistant.llm.answer import ModelAnswer, answer_schema, read_answer
from edge.assistant.llm.claims import Claim, KnownFacts, check_claims
from edge.assistant.llm.interrupt import Interrupt
from edge.assistant.llm.language_model import LanguageModel
from edge.assistant.llm.ledger import AnsweredCall, Ledger, Tool
from edge.assistant.llm.prompts import question, system_prompt
from edge.assistant.llm.simulate_tool import SimulateTool, Simulator, cited_forecast
from edge.assistant.llm.sql_tool import SqlTool
from edge.core.controller import Context, Floats, goal_ahead
from edge.core.controller_names import LlmVariant
from edge.core.messages import Command
from edge.core.plain_text import plain
from edge.core.predictor import Predictor

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
            schema=answer_schema(simulator is not None),
        )
        content = conversation.run(model.settings.answer_age_max_s, stop)
        answer = read_answer(content, simulator is not None)
        forecast = () if simulator is None else cited_forecast(answer, conversation.ledger, simulator)
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
    return [_simulation(entry) if entry.tool == "simulate" else _query(entry) for entry in ledger.entries]


def _simulation(entry: AnsweredCall) -> dict[str, Any]:
    result = entry.result
    first = {"heater_duty": result["heater_duty"][0], "fan_on": result["fan_on"][0]}
    error_k = result["mean_abs_error_k"]
    return {"id": entry.id, **first, "steps": len(result["fan_on"]), "mean_abs_error_k": error_k}


def _query(entry: AnsweredCall) -> dict[str, Any]:
    query = plain(str(entry.arguments["query"]), QUERY_MAX)
    return {"id": entry.id, "query": query, "rows": entry.result["coverage"]["rows"]}
