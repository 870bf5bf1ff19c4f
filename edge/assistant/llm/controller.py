"""`LLM-Te0` and its kin: a controller whose decisions come from a thread that may take its time."""

from collections import Counter

from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.language_model import LanguageModel, Question
from edge.assistant.llm.proposal import Architecture, ModelProposal
from edge.core.controller import Context
from edge.core.messages import Decision, Event, Severity

WAIT_SHARE = 0.85  # of a tick's deadline; the rest is for handing the decision back


class LlmController:
    """Asks at every tick at which nothing is under way, and waits almost until the tick's deadline.

    An answer that comes later serves a later tick, once, if it is no older than llm.answer_age_max_s then.
    """

    def __init__(
        self,
        name: str,
        model: LanguageModel,
        architecture: Architecture,
        deadline_s: float,
        unequipped: str = "",
    ) -> None:
        """`deadline_s`: of a decision, in wall time; `unequipped`: what is missing, "" where nothing is."""
        self.name = name
        self._model = model
        self._architecture = architecture
        self._wait_s = WAIT_SHARE * deadline_s
        self._unequipped = unequipped
        self._failures: Counter[str] = Counter()
        self._under_way: Question[ModelProposal] | None = None
        self._arrived: Question[ModelProposal] | None = None  # came too late for the tick that asked

    def reset(self) -> None:
        """Drop what is under way and what has arrived."""
        if self._under_way is not None:
            self._under_way.drop()
        self._under_way = self._arrived = None

    def decide(self, context: Context) -> Decision:
        """Return the model's proposal. Raises : LlmFailure, with its kind and the count of each kind"""
        if self._unequipped:
            raise self._count(LlmFailure("unequipped", self._unequipped))
        self._look_after(context.now_s)
        if self._under_way is None:
            self._under_way = self._ask(context)
        question = self._under_way
        if question.wait(self._wait_s):
            self._under_way = self._arrived = None
            return self._decision(question, context)
        if self._arrived is not None:
            question, self._arrived = self._arrived, None
            return self._decision(question, context)
        raise self._count(LlmFailure("late", f"no answer within {self._wait_s:.2g} s; it goes on"))

    def _look_after(self, now_s: float) -> None:
        """Collect the answer to an earlier tick's question when it has arrived,
        and drop one that is too old.
        """
        if self._under_way is not None:
            if self._under_way.wait(0.0):
                self._arrived, self._under_way = self._under_way, None
            elif self._is_old(self._under_way, now_s):
                self._under_way.drop()
                self._under_way = None
        if self._arrived is not None and self._is_old(self._arrived, now_s):
            self._arrived = None

    def _is_old(self, question: Question[ModelProposal], now_s: float) -> bool:
        return not now_s - question.asked_s <= self._model.settings.answer_age_max_s

    def _ask(self, context: Context) -> Question[ModelProposal]:
        question = Question(
            lambda stop: self._architecture.propose(self._model, context, stop), context.now_s
        )
        self._model.under_way(question)
        return question

    def _decision(self, question: Question[ModelProposal], context: Context) -> Decision:
        try:
            proposal = question.answer()
        except LlmFailure as failure:
            raise self._count(failure) from None
        if proposal.flagged:
            said = "; ".join(f"{claim.text!r} ({claim.against})" for claim in proposal.flagged)
            text = f"{self.name} claims what does not hold: {said}"
            self._model.tell(Event("llm.claim", Severity.WARNING, text, context.now_s, context.utc))
        asked_s_ago = context.now_s - question.asked_s
        passed = round(asked_s_ago / context.step_s)
        why = {**proposal.why, "asked_s_ago": asked_s_ago, "failures": dict(self._failures)}
        return Decision(proposal.command, self.name, proposal.forecast[passed:], why)

    def _count(self, failure: LlmFailure) -> LlmFailure:
        self._failures[failure.kind] += 1
        so_far = ", ".join(f"{kind} {count}" for kind, count in sorted(self._failures.items()))
        return LlmFailure(failure.kind, f"{failure.text} (so far: {so_far})")
