"""The bounded queue between the loop, which never waits, and the writer thread, which may have to."""

import threading
from collections import deque

from edge.core.messages import TickRecord


class TickQueue:
    """First in, first out; when it is full the oldest tick is dropped and its number kept."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._records: deque[TickRecord] = deque()
        self._lost: list[tuple[int, int]] = []  # ranges of numbers, first and last
        self._changed = threading.Condition()
        self._closed = False

    def put(self, record: TickRecord) -> None:
        """Append; never waits."""
        with self._changed:
            if len(self._records) >= self._capacity:
                self._note_lost(self._records.popleft().seq)
            self._records.append(record)
            self._changed.notify_all()

    def take(self, limit: int) -> list[TickRecord]:
        """Up to `limit` of the oldest, waiting for the first; nothing when closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._records or self._closed)
            return [self._records.popleft() for _ in range(min(limit, len(self._records)))]

    def take_lost(self) -> list[tuple[int, int]]:
        """Ranges of numbers dropped since the last call."""
        with self._changed:
            lost, self._lost = self._lost, []
            return lost

    def wait_closed(self, timeout_s: float) -> bool:
        """Wait until it is closed, at most `timeout_s`. Returns whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: self._closed, timeout_s)

    def close(self) -> None:
        """Wake whoever waits; what is queued can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def __len__(self) -> int:
        return len(self._records)

    def _note_lost(self, seq: int) -> None:
        if self._lost and self._lost[-1][1] == seq - 1:
            self._lost[-1] = (self._lost[-1][0], seq)
        else:
            self._lost.append((seq, seq))
