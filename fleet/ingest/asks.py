"""Requests to a rig for ticks that are missing: when, and for which. Values alone: time and gaps are given.

One request at a time, the newest gap first and its newest ticks first. A rig that has none of them is asked
for twice as many, so a jump of its numbers by a billion takes twenty requests.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from fleet.ingest.spans import Span

CHUNK = 2000  # ticks of the first request: a day and a half at one a minute
CHUNK_MAX = 2**53
REPLY_S = 10.0  # a rig that has not answered by then is asked again
STALL_S = 20.0  # after the last of its ticks
PAUSE_FIRST_S = 5.0  # of a request that led to nothing, doubled with each further one
SILENT_MAX_S = 60.0  # longest pause after silence: the rig may have been connecting
STALLED_MAX_S = 3600.0  # after an answer whose ticks never came
PAUSES_MAX = 100  # requests whose failure is remembered


@dataclass(slots=True)
class Ask:
    """A request under way. left : ticks of it that are missing still; moved_s : when one came last"""

    span: Span
    asked_s: float
    left: int
    moved_s: float
    is_answered: bool = False


@dataclass(slots=True)
class Pause:
    """A request that led to nothing."""

    length_s: float
    until_s: float


class Asks:
    """The requests to one rig. wait_s : a gap has to be so old"""

    def __init__(self, wait_s: float) -> None:
        self._wait_s = wait_s
        self._since: dict[int, float] = {}  # first number of a gap -> when it was seen first
        self._pauses: dict[Span, Pause] = {}
        self._chunk = CHUNK
        self.ask: Ask | None = None

    def look(self, missing: Sequence[Span], now_s: float) -> Span | None:
        """Return the span to ask for now, None for nothing. missing : of the rig's present history, rising"""
        # Ticks that come in order move the beginning of the last gap, so an outbox that empties is no gap.
        self._since = {first: self._since.get(first, now_s) for first, _ in missing}
        if self.ask is not None and not self._is_over(self.ask, missing, now_s):
            return None
        self.ask = None
        for first, last in reversed(missing):
            span = (max(first, last - self._chunk + 1), last)
            paused = span in self._pauses and now_s < self._pauses[span].until_s
            if now_s - self._since[first] >= self._wait_s and not paused:
                self.ask = Ask(span, now_s, last - span[0] + 1, now_s)
                return span
        return None

    def answer(self, span: Span, queued: int, now_s: float) -> Span | None:
        """Take a rig's answer; return the span if it has nothing of it."""
        if self.ask is None or self.ask.span != span:  # somebody else's request
            return None
        if queued > 0:
            self.ask.is_answered, self.ask.moved_s, self._chunk = True, now_s, CHUNK
            return None
        self.ask, self._chunk = None, min(2 * self._chunk, CHUNK_MAX)
        self._pause(span, STALLED_MAX_S, now_s)  # where no history is known yet, its absence can't be noted
        return span

    def _is_over(self, ask: Ask, missing: Sequence[Span], now_s: float) -> bool:
        """Return whether nothing more is to be expected of a request."""
        left = sum(max(0, min(last, ask.span[1]) - max(first, ask.span[0]) + 1) for first, last in missing)
        if left < ask.left:
            ask.left, ask.moved_s = left, now_s
        if left == 0:
            self._pauses.pop(ask.span, None)
            return True
        if now_s - ask.moved_s <= (STALL_S if ask.is_answered else REPLY_S):
            return False
        self._pause(ask.span, STALLED_MAX_S if ask.is_answered else SILENT_MAX_S, now_s)
        return True

    def _pause(self, span: Span, most_s: float, now_s: float) -> None:
        before = self._pauses.pop(span, None)
        length_s = min(most_s, 2 * before.length_s if before else PAUSE_FIRST_S)
        if len(self._pauses) >= PAUSES_MAX:
            self._pauses.pop(next(iter(self._pauses)))
        self._pauses[span] = Pause(length_s, now_s + length_s)
