"""Time limit of a search: CPU time of its thread, so that a busy machine costs no quality; and wall time."""

import time
from collections.abc import Callable

# Wall time per CPU time. With three busy processes per core a search still gets its CPU time. The default of
# 250 ms ends after 750 ms at the latest, within the second that a fallback may take.
WALL_FACTOR = 3.0


class TimeBox:
    """A limit that begins when the object is made, for the thread that makes it.

    cpu_s : CPU time of this thread [s]
    wall_s : wall time, None: WALL_FACTOR times `cpu_s` [s]
    cpu, wall : clocks [s]
    """

    def __init__(
        self,
        cpu_s: float,
        wall_s: float | None = None,
        cpu: Callable[[], float] = time.thread_time,
        wall: Callable[[], float] = time.monotonic,
    ) -> None:
        self._cpu, self._wall = cpu, wall
        self._cpu_end_s = cpu() + cpu_s
        self._wall_end_s = wall() + (WALL_FACTOR * cpu_s if wall_s is None else wall_s)

    def is_over(self) -> bool:
        """Return whether either time is used up."""
        return self._cpu() > self._cpu_end_s or self._wall() > self._wall_end_s
