"""The sign of life to a service elsewhere, which tells people when it stays away.

It is withheld while the daemon is silent, makes no ticks, or nobody here looks for alarms. So whatever ends,
of daemon, page, machine and network, the service notices.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from edge.config.alarm_settings import LifeSignSettings
from edge.page.alarms.alarm_state import ChannelNote
from edge.page.alarms.channels import LIFE_SIGN, give_life_sign, host_of
from edge.page.alarms.exchange import SendError
from edge.page.alarms.messenger import Retries
from edge.page.alarms.sender import Sender


@dataclass(slots=True)
class LifeSign:
    """Gives signs while `problem` returns "". utc, clock : wall [s since 1970] and monotonic time [s]"""

    settings: LifeSignSettings
    note: ChannelNote
    problem: Callable[[], str]
    utc: Callable[[], float]
    clock: Callable[[], float]
    sender: Sender = field(default_factory=Sender)
    retries: Retries = field(init=False)
    to: str = field(init=False)  # the service's host
    _due_s: float = float("-inf")

    def __post_init__(self) -> None:
        self.retries = Retries(self.clock)
        self.to = host_of(self.settings, LIFE_SIGN)

    async def give_if_due(self) -> None:
        """Give a sign, if it is time for one and nothing speaks against it."""
        if self.clock() >= max(self._due_s, self.retries.next_s):
            await self.give()

    async def give(self) -> str:
        """Give one sign; return why it did not arrive, or why it is withheld, "" where it arrived."""
        if reason := self.problem():
            return f"withheld, so that the service notices: {reason}"
        begun_s = self.clock()  # a slow answer does not put the next sign off
        try:
            await self.sender.run(lambda cut: give_life_sign(self.settings, cut))
        except SendError as error:
            self.retries.note(error, self.settings.every_s)
            self.note = replace(self.note, failed_utc=round(self.utc(), 3), reason=str(error))
            return str(error)
        self.retries.note(None)
        self._due_s = begun_s + self.settings.every_s
        self.note = replace(self.note, sent_utc=round(self.utc(), 3))
        return ""

    def json(self) -> dict[str, Any]:
        """Return what people see of it."""
        return {
            "name": LIFE_SIGN,
            "to": self.to,
            "sent_utc": self.note.sent_utc,
            "failed_utc": self.note.failed_utc,
            "reason": self.note.reason,
            "withheld": self.problem(),
        }
