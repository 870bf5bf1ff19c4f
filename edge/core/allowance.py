"""How many messages are let in: so many at once, and so many a second from then on; others are counted."""

import threading
from collections.abc import Callable


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
