"""Time of the lab: simulated, or a multiple of real time; no thread waits for it.

`labtime` is shared by all labs and by `clock`, as in the package `tclab`. A lab can go by that package's too.
"""

import math
import time
from collections.abc import Callable, Iterator
from typing import Protocol

from edge.core.errors import RequestError


class LabClock(Protocol):
    """A source of lab time."""

    def time(self) -> float:
        """Return the lab's time [s], from any origin."""
        ...


class LabTime:
    """Seconds that pass while somebody sleeps, and at `speed` times real time where that is not 0.

    At speed 0 a program runs as fast as the machine does, and gives the same result every time.
    """

    def __init__(
        self,
        monotonic: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self._monotonic, self._wait = monotonic, wait
        self._speed, self._since, self._passed_s = 0.0, monotonic(), 0.0

    def set_rate(self, speed: float) -> None:
        """Set the seconds of the lab in a real second, 0 for a lab that never waits.

        Errors : RequestError for a speed that is negative or not finite
        """
        if not (speed >= 0.0 and math.isfinite(speed)):
            raise RequestError(f"speed: {speed:g} is not a finite number of 0 or more")
        self._passed_s, self._since = self.time(), self._monotonic()
        self._speed = speed

    def get_rate(self) -> float:
        """Return the seconds of the lab in a real second."""
        return self._speed

    def time(self) -> float:
        """Return the seconds since the process began to use it."""
        return self._passed_s + self._speed * (self._monotonic() - self._since)

    def sleep(self, delay_s: float) -> None:
        """Let `delay_s` of the lab pass; no time passes where it is not above 0."""
        if not delay_s > 0.0:
            return
        if self._speed > 0.0:
            self._wait(delay_s / self._speed)
        else:
            self._passed_s += delay_s


labtime = LabTime()


def clock(
    period: float, step: float = 1.0, tol: float = math.inf, adaptive: bool = True, source: LabTime = labtime
) -> Iterator[float]:
    """Yield 0, `step`, ... up to `period` [s], each when its time has come.

    tol, adaptive : as `tclab.clock` takes them, of no effect: simulated time is never late
    source : of the time
    Errors : RequestError for a step that is not above 0
    """
    if not step > 0.0:
        raise RequestError(f"clock: a step of {step:g} s is not above 0")
    begin = source.time()
    for k in range(math.floor(period / step + 1e-9) + 1):
        source.sleep(begin + k * step - source.time())
        yield round(k * step, 2)
