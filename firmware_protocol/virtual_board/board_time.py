"""The board's clock: milliseconds in 32 bits, which wrap after 49.7 days."""

_MASK = 0xFFFFFFFF


def wrap(ms: int) -> int:
    """Return a time as the board's clock shows it."""
    return ms & _MASK


def elapsed_ms(now_ms: int, since_ms: int) -> int:
    """Time that passed [ms], right across a wrap; a clock that goes back shows as very much."""
    return (now_ms - since_ms) & _MASK
