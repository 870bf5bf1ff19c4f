"""The heater's duty as the board takes it: in steps of 1/20."""

from edge.core.names import HEATER_LEVELS


def levels_allowed(max_duty: float) -> int:
    """Highest level (duty * 20) that is not above `max_duty`; 0 when that is not a number."""
    if not max_duty > 0.0:
        return 0
    return int(min(max_duty, 1.0) * HEATER_LEVELS + 1e-9)  # 0.15 * 20 is 3 less a rounding error
