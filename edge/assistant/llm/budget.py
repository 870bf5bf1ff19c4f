"""Daily budget of a language model by UTC day: charged before a request, corrected by the counted tokens."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Annotated

from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.wire import Usage
from edge.config.settings import LlmSettings
from edge.formats.cross_check import REQUIRED, Rule


@dataclass(frozen=True, slots=True)
class Spending:
    """Tokens and requests spent on one UTC day."""

    day: str
    tokens: Annotated[int, Rule(low=0)] = field(default=0, metadata=REQUIRED)
    cost: Annotated[float, Rule(low=0.0)] = field(default=0.0, metadata=REQUIRED)
    exchanges: Annotated[int, Rule(low=0)] = field(default=0, metadata=REQUIRED)


class Budget:
    """The budget of all clients, thread-safe.

    spent : by the process before, on whatever day; save : called with every change, never waits
    """

    def __init__(
        self,
        settings: LlmSettings,
        spent: Spending,
        save: Callable[[Spending], None],
        utc: Callable[[], float],
    ) -> None:
        self._settings = settings
        self._utc = utc
        self._lock = threading.Lock()
        self._spent, self._save = spent, save

    def charge(self, most: Usage) -> None:
        """Before an exchange: what it may cost at most. Errors: LlmFailure, over_budget

        Charged at once, so that two who ask at a time can't spend the same tokens.
        """
        with self._lock:
            spent = self._of_today()
            if reason := self._too_much(spent, most):
                raise LlmFailure("over_budget", reason)
            self._keep(spent, most.sent + most.received, self.cost(most), 1)

    def settle(self, most: Usage, used: Usage) -> None:
        """After an exchange: what was charged for is replaced by what was used."""
        with self._lock:
            tokens = used.sent + used.received - most.sent - most.received
            self._keep(self._of_today(), tokens, self.cost(used) - self.cost(most), 0)

    def cost(self, usage: Usage) -> float:
        """In the prices' currency."""
        return 1e-6 * (usage.sent * self._settings.price_in + usage.received * self._settings.price_out)

    @property
    def spent(self) -> Spending:
        """So far today."""
        with self._lock:
            return self._of_today()

    def _too_much(self, spent: Spending, most: Usage) -> str:
        """ "" where the exchange fits into the day; what is no number does not."""
        settings = self._settings
        tokens = spent.tokens + most.sent + most.received
        if settings.tokens_per_day and not tokens <= settings.tokens_per_day:
            return f"{spent.tokens} of {settings.tokens_per_day} tokens are spent today"
        cost = spent.cost + self.cost(most)
        if settings.cost_per_day and not cost <= settings.cost_per_day:
            return f"{spent.cost:.4g} of {settings.cost_per_day:g} is spent today"
        return ""

    def _keep(self, spent: Spending, tokens: int, cost: float, exchanges: int) -> None:
        # An exchange that went over midnight may give back more than the new day has.
        self._spent = Spending(
            spent.day, max(0, spent.tokens + tokens), max(0.0, spent.cost + cost), spent.exchanges + exchanges
        )
        self._save(self._spent)

    def _of_today(self) -> Spending:
        today = datetime.fromtimestamp(self._utc(), UTC).date().isoformat()
        return self._spent if self._spent.day == today else Spending(today)
