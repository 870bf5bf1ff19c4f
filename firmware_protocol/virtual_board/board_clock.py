"""The board's own clock: milliseconds since boot, 32 bits wide, maybe fast or slow."""

WRAP_MS = 1 << 32


class BoardClock:
    """Maps simulated time to board_ms."""

    def __init__(self, now_ms: int) -> None:
        self._since_ms = now_ms
        self._board_ms = 0.0
        self._factor = 1.0

    def read(self, now_ms: int) -> int:
        """board_ms, 0 .. 2^32 - 1."""
        return int(self._board_ms + (now_ms - self._since_ms) * self._factor) % WRAP_MS

    def set_factor(self, factor: float, now_ms: int) -> None:
        """Run this much faster than time from now on."""
        if factor != self._factor:
            self._board_ms += (now_ms - self._since_ms) * self._factor
            self._since_ms, self._factor = now_ms, factor

    def set_before_wrap(self, before_s: float, now_ms: int) -> None:
        """Jump to this long before the wrap."""
        self._since_ms, self._board_ms = now_ms, WRAP_MS - before_s * 1000.0
