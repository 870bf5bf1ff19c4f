"""Ledgers: of each rig the ticks that are stored, those that never come, and the newest that it named."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from edge.core.messages import Severity
from fleet.ingest.asks import Asks
from fleet.ingest.spans import Refused, Span, Spans
from fleet.ingest.tick import Tick, TickEvent

JUMP_MAX = 1_000_000  # ticks; two years at one a minute, eleven days at one a second
JUMPED = "history.jumped"  # key of the event
SPANS_MAX = 10_000  # of one history; more are those of a rig that sends every second tick
HISTORIES_MAX = 64  # of one rig: a new one is begun when its card is changed or its file is broken
AGREE_TICKS = 10  # in a row: so many show that numbers which have jumped are the rig's own from now on
LATER_MAX_S = 3600.0  # an older tick can't be this much later, but where a clock was set


@dataclass(slots=True)
class HistoryLedger:
    """Ticks of one history. newest_utc : of the tick with the largest number, 0 before one came

    far : first and last of the ticks in a row that were refused as a jump; far_utc : of the last one
    """

    stored: Spans = field(default_factory=Spans)
    absent: Spans = field(default_factory=Spans)
    newest_utc: float = 0.0
    far: Span = (0, 0)
    far_utc: float = 0.0

    def copy(self) -> "HistoryLedger":
        """Return the same, to be changed apart."""
        return HistoryLedger(self.stored.copy(), self.absent.copy(), self.newest_utc, self.far, self.far_utc)

    def take(self, tick: Tick) -> bool:
        """Note a tick; return whether it is new. Errors: Refused"""
        if tick.seq in self.stored:
            return False
        self._check(tick)
        if self.is_jump(tick):  # the rig's new numbers: none lie between, and those of the row are asked for
            self.absent.add(self.stored.newest + 1, self.far[0] - 1)
        self.stored.add(tick.seq, tick.seq)
        self.absent.cut(tick.seq, tick.seq)
        if tick.seq == self.stored.newest:
            self.newest_utc = tick.utc
        return True

    def give_up(self, span: Span) -> None:
        """Note numbers that never come; those that are stored stay so."""
        for first, last in self.stored.missing(*span):
            self.absent.add(first, last)

    def missing(self, last: int) -> list[Span]:
        """Return the spans up to `last` of which nothing is known."""
        gaps = self.stored.missing(1, max(last, self.stored.newest))
        return [gap for wide in gaps for gap in self.absent.missing(*wide)]

    def _check(self, tick: Tick) -> None:
        newest = self.stored.newest
        if self.is_jump(tick) and not self._goes_on(tick):
            raise Refused("jump", f"tick {tick.seq}: the newest before it was {newest}")
        if tick.seq < newest and self.newest_utc and tick.utc > self.newest_utc + LATER_MAX_S:
            raise Refused("order", f"tick {tick.seq}: it is later than tick {newest}")
        if len(self.stored) >= SPANS_MAX and not self.stored.touches(tick.seq):
            raise Refused("scattered", f"tick {tick.seq}: {SPANS_MAX} spans with gaps between them")

    def is_jump(self, tick: Tick) -> bool:
        """Return whether its number is too far beyond the newest to follow it."""
        return self.stored.newest > 0 and tick.seq > self.stored.newest + JUMP_MAX

    def _goes_on(self, tick: Tick) -> bool:
        """Note a tick that has jumped; return whether as many as AGREE_TICKS have followed one another."""
        first, last = self.far
        if tick.is_resend or first <= tick.seq <= last:
            return False
        is_next = tick.seq == last + 1 and tick.utc >= self.far_utc
        self.far, self.far_utc = (first if is_next else tick.seq, tick.seq), tick.utc
        return self.far[1] - self.far[0] + 1 >= AGREE_TICKS


class RigLedger:
    """A rig.

    told : the newest number by its topic `state`; current : id of the history that it writes now
    is_loaded : its histories are those of the database
    """

    def __init__(self, wait_s: float) -> None:
        self.histories: dict[str, HistoryLedger] = {}
        self.current = ""
        self.told = 0
        self.is_online = False
        self.is_loaded = False
        self.asks = Asks(wait_s)

    def load(self, histories: dict[str, HistoryLedger]) -> None:
        """Take what the database has; before its first tick, the rig's history is the one that is longest."""
        for history_id, own in histories.items():
            if history_id in self.histories:
                own.newest_utc = self.histories[history_id].newest_utc
        self.histories, self.is_loaded = histories, True
        if self.current not in histories:
            self.current = max(histories, key=lambda name: histories[name].stored.newest, default="")

    def missing(self) -> list[Span]:
        """Return the spans to ask for, rising: of the present history, for the rig has no other."""
        if not self.is_loaded:
            return []
        own = self.histories.get(self.current, HistoryLedger())
        is_near = not own.stored or self.told <= own.stored.newest + JUMP_MAX
        return own.missing(self.told if is_near else 0)


class RigPlan:
    """Histories of one rig as they will be once a batch is stored; the ledger stays as it is until then."""

    def __init__(self, ledger: RigLedger) -> None:
        self._ledger = ledger
        self.histories: dict[str, HistoryLedger] = {}  # those that a batch changes
        self.current = ledger.current

    def take(self, tick: Tick) -> Tick | None:
        """Note a tick; return it if it is new, with an event where numbers have jumped. Errors: Refused"""
        own = self._history(tick.history_id)
        before, has_jumped = own.stored.newest, own.is_jump(tick)
        if not own.take(tick):
            fresh = None
        elif has_jumped:
            text = f"numbers of its ticks go on from {own.far[0]}; the newest before was {before}"
            event = TickEvent(JUMPED, Severity.WARNING.value, text, tick.utc)
            fresh = replace(tick, events=(*tick.events, event))
        else:
            fresh = tick
        if not tick.is_resend:
            self.current = tick.history_id
        return fresh

    def give_up(self, history_id: str, span: Span) -> None:
        """Note ticks that never come. One far ahead of all others would be a gap, and is left out."""
        if history_id not in self._ledger.histories and history_id not in self.histories:
            return
        own = self._history(history_id)
        if own.stored and span[1] <= own.stored.newest + JUMP_MAX:
            own.give_up(span)

    def _history(self, history_id: str) -> HistoryLedger:
        if history_id not in self.histories:
            before = self._ledger.histories.get(history_id)
            known = self._ledger.histories.keys() | self.histories.keys()
            if before is None and len(known) >= HISTORIES_MAX:
                raise Refused("history", f"history {history_id}: the rig has had {HISTORIES_MAX} already")
            self.histories[history_id] = before.copy() if before else HistoryLedger()
        return self.histories[history_id]

    def settle(self) -> None:
        """Let the ledger be what was stored."""
        self._ledger.histories.update(self.histories)
        self._ledger.current = self.current


def changed_spans(before: Iterable[Span], after: Iterable[Span]) -> tuple[list[int], list[Span]]:
    """Return which rows go, by their first numbers, and which are written."""
    old, new = dict(before), dict(after)
    gone = [first for first, last in old.items() if new.get(first) != last]
    return gone, [(first, last) for first, last in new.items() if old.get(first) != last]
