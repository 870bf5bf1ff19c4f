"""Conditions that last: one event when they begin, one when they end, and silence in between."""

from edge.core.messages import Event, Severity
from edge.tick.faults import FAILURES


class Conditions:
    """Which rows of the failure table hold now."""

    def __init__(self) -> None:
        self._since: dict[str, float] = {}
        self._events: list[Event] = []

    def set(self, key: str, holds: bool, time_s: float, utc: float, detail: str = "") -> None:
        """Say whether `key` of the failure table holds at this tick. Errors: KeyError for an unknown key."""
        failure = FAILURES[key]
        if holds and key not in self._since:
            self._since[key] = time_s
            text = f"{failure.what}{f': {detail}' if detail else ''}; {failure.answer}"
            self._events.append(Event(key, failure.severity, text, time_s, utc))
        elif not holds and key in self._since:
            lasted_s = time_s - self._since.pop(key)
            text = f"over after {lasted_s:.0f} s: {failure.what}"
            self._events.append(Event(f"{key}.over", Severity.INFO, text, time_s, utc))

    def holds(self, key: str) -> bool:
        """Return whether `key` holds since an earlier `set`."""
        return key in self._since

    def take_events(self) -> list[Event]:
        """Beginnings and ends since the last call."""
        events, self._events = self._events, []
        return events
