"""Time for the loop. `time_s` is monotonic, `utc` is for storage only; neither is ever used as the other."""

import select
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


class Port(Protocol):
    """The part of an open serial port that the clock needs: a file
    descriptor, and counted bytes for lock-step.
    """

    bytes_out: int
    bytes_in: int

    def fileno(self) -> int:
        """Descriptor to wait on."""
        ...


class Clock(Protocol):
    """Who owns time: the machine (`RealClock`) or the simulated board (`SimClock`)."""

    def now(self) -> float:
        """Monotonic time [s]."""
        ...

    def utc(self) -> float:
        """Seconds since 1970, for storage."""
        ...

    def wait(self, port: Port | None, wake: int | None, until_s: float) -> None:
        """Return when `until_s` is reached, when `port` has bytes, or when descriptor `wake` is readable."""
        ...


def boot_id() -> str:
    """Return the id of the machine's boot, "" if unknown. Within a boot
    CLOCK_MONOTONIC continues between processes.
    """
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


@dataclass(frozen=True, slots=True)
class Moment:
    """One moment by both clocks. boot_id : "" where the monotonic clock is of this process alone"""

    boot_id: str
    time_s: float
    utc: float

    def elapsed_s(self, now: "Moment") -> float:
        """Return the time since then, at least 0; after a reboot only the wall clock measures it."""
        is_same_boot = self.boot_id == now.boot_id != ""
        return now.time_s - self.time_s if is_same_boot else max(0.0, now.utc - self.utc)


class RealClock:
    """The machine's clocks."""

    def now(self) -> float:
        """CLOCK_MONOTONIC [s]."""
        return time.monotonic()

    def utc(self) -> float:
        """Wall clock [s since 1970]."""
        return time.time()

    def wait(self, port: Port | None, wake: int | None, until_s: float) -> None:
        """Sleep in the kernel until bytes, a wake-up or the time."""
        descriptors = [wake] if wake is not None else []
        if port is not None:
            descriptors.append(port.fileno())
        select.select(descriptors, [], [], max(0.0, until_s - self.now()))
