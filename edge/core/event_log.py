"""Events between two ticks, and the rate limit by which nothing outside can fill the history with them."""

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from edge.core.messages import Event, Severity


class Allowance:
    """A token bucket for any thread.

    burst : messages at once; per_s : at length [1/s]
    """

    def __init__(self, burst: int, per_s: float, clock: Callable[[], float]) -> None:
        self._burst, self._per_s, self._clock = burst, per_s, clock
        self._lock = threading.Lock()
        self._left = float(burst)
        self._at_s = clock()
        self.refused = 0
        self.refused_s = float("-inf")  # when the last one was refused

    @property
    def has_room(self) -> bool:
        """Return whether `take` would return True now."""
        with self._lock:
            return self._left + self._per_s * (self._clock() - self._at_s) >= 1.0

    def take(self) -> bool:
        """Take one place; return False when none is left."""
        with self._lock:
            now = self._clock()
            self._left = min(self._burst, self._left + self._per_s * (now - self._at_s))
            self._at_s = now
            if self._left >= 1.0:
                self._left -= 1.0
                return True
        self.refuse()
        return False

    def refuse(self) -> None:
        """Count one that could not be let in."""
        with self._lock:
            self.refused += 1
            self.refused_s = self._clock()


_GRAVER = (Severity.INFO, Severity.WARNING, Severity.ALARM)


class EventLog:
    """Keeps the first events of each key whole; one event says how often the key came after these.

    whole : events of a key that are kept before it is counted
    """

    def __init__(self, whole: int = 1) -> None:
        self._whole = whole
        self._events: list[Event] = []
        self._counts: Counter[str] = Counter()
        self._last: dict[str, Event] = {}  # of each key that came too often, with the gravest severity

    def add(self, *events: Event) -> None:
        """Take events in the order in which they happened."""
        for event in events:
            self._counts[event.key] += 1
            if self._counts[event.key] <= self._whole:
                self._events.append(event)
            else:
                before = self._last.get(event.key, event)
                gravest = max(event.severity, before.severity, key=_GRAVER.index)
                self._last[event.key] = replace(event, severity=gravest)

    def take(self) -> list[Event]:
        """Return the events since the last call."""
        summaries = [self._summary(event) for event in self._last.values()]
        events = [*self._events, *summaries]
        self._events, self._counts, self._last = [], Counter(), {}
        return events

    def _summary(self, last: Event) -> Event:
        more = self._counts[last.key] - self._whole
        return last if more == 1 else replace(last, text=f"{more} more times, the last one: {last.text}")
