"""One channel at work: when it may send, how it has done, and when it tries again."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from edge.page.alarms.alarm_message import AlarmMessage
from edge.page.alarms.alarm_state import ChannelNote
from edge.page.alarms.channels import Channel
from edge.page.alarms.exchange import SendError
from edge.page.alarms.sender import Sender

MESSAGES_MAX, MESSAGES_S = 5, 600.0  # in that time; what comes more often is told together by the next one
AGAIN_MIN_S, AGAIN_MAX_S = 10.0, 300.0  # between tries, doubled for each that fails
AGAIN_REFUSED_S = 3600.0  # at most, where the server refuses: mail servers lock out who tries too often


@dataclass(slots=True)
class Retries:
    """When to try again after failures. clock : monotonic [s]"""

    clock: Callable[[], float]
    failures: int = 0
    next_s: float = float("-inf")

    def note(self, error: SendError | None, most_s: float = AGAIN_REFUSED_S) -> None:
        """Note how a try has ended. error : None for well;  most_s : longest pause [s]"""
        if error is None:
            self.failures, self.next_s = 0, float("-inf")
            return
        wait_s = AGAIN_MIN_S * 2.0 ** min(self.failures, 20)
        self.failures += 1
        self.next_s = self.clock() + min(wait_s, most_s, AGAIN_REFUSED_S if error.lasting else AGAIN_MAX_S)

    @property
    def wait_s(self) -> float:
        """Time until the next try [s]."""
        return max(0.0, self.next_s - self.clock())


@dataclass(slots=True)
class Messenger:
    """A channel, its past and its next try. utc, clock : wall [s since 1970] and monotonic time [s]"""

    channel: Channel
    note: ChannelNote
    utc: Callable[[], float]
    clock: Callable[[], float]
    sender: Sender = field(default_factory=Sender)
    retries: Retries = field(init=False)
    _sent: deque[float] = field(default_factory=lambda: deque(maxlen=MESSAGES_MAX))

    def __post_init__(self) -> None:
        self.retries = Retries(self.clock)

    @property
    def wait_s(self) -> float:
        """Time until the next message may be tried [s]."""
        is_storm = len(self._sent) == MESSAGES_MAX
        storm_s = self._sent[0] + MESSAGES_S - self.clock() if is_storm else 0.0
        return max(0.0, storm_s, self.retries.wait_s)

    async def send(self, message: AlarmMessage) -> bool:
        """Send a message; return whether it arrived. Never raises for a failure, which `note` names."""
        try:
            remark = await self.sender.run(lambda cut: self.channel.send(message, cut))
        except SendError as error:
            self.retries.note(error)
            self.note = replace(self.note, failed_utc=round(self.utc(), 3), reason=str(error))
            return False
        self.retries.note(None)
        self.note = replace(self.note, sent_utc=round(self.utc(), 3))
        if remark:  # it has not reached everybody
            self.note = replace(self.note, failed_utc=self.note.sent_utc, reason=remark)
        return True

    async def send_alarms(self, message: AlarmMessage) -> bool:
        """Send a message that counts against the limit of storms."""
        arrived = await self.send(message)
        if arrived:
            self._sent.append(self.clock())
        return arrived

    def json(self, waiting: int) -> dict[str, Any]:
        """Return what people see of it. waiting : alarms that it has still to name"""
        return {
            "name": self.channel.name,
            "to": self.channel.to,
            "sent_utc": self.note.sent_utc,
            "failed_utc": self.note.failed_utc,
            "reason": self.note.reason,
            "waiting": waiting,
            "wait_s": round(self.wait_s, 1),
        }
