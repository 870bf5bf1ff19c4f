"""Progress of a long computation: its present step, and the share that is done."""

import math
import shutil
import sys
import time
from collections.abc import Callable
from typing import Self, TextIO

Telling = Callable[[str], None]  # a short text, what is done now; called often
Progress = Callable[[str, float], None]  # the same with the share of all that is done by now, 0..1
BAR = 20  # characters
SOON_S = 2.0  # before which nothing is known of how long it takes


class Stage:
    """A part of a computation whose number of steps nobody knows beforehand.

    Each step takes away the same share of what is left, so that a longer one slows down and never ends early.
    """

    def __init__(self, progress: Progress, begin: float, end: float, steps: float) -> None:
        """begin, end : shares of the whole; steps : after which 63 % of the part is usually done"""
        self._progress, self._begin, self._end, self._steps = progress, begin, end, steps
        self._told = 0

    def __call__(self, text: str) -> None:
        """Report `text` and count a step; the first call reports `begin`, and no call reaches `end`."""
        done = 1.0 - math.exp(-self._told / self._steps)
        self._told += 1
        self._progress(text, self._begin + done * (self._end - self._begin))


class TerminalProgress:
    """Progress on a terminal as one line that is rewritten, anywhere else as lines.

    A context manager: at its end the line is gone.
    """

    def __init__(self, out: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """out : standard error unless given; clock : [s]"""
        self._out = sys.stderr if out is None else out
        self._rewrites = self._out.isatty()
        self._clock, self._begun_s = clock, clock()
        self._share = 0.0  # that was told: a stage may be gone back to, a share that is done is

    def __call__(self, text: str, share: float) -> None:
        """Show `text` at `share` [0..1]; a share that falls is shown at its largest value so far."""
        share = self._share = max(share, self._share)
        line = "".join(character if character.isprintable() else " " for character in text)
        if self._rewrites:
            bar = "#" * round(BAR * share)
            columns = shutil.get_terminal_size().columns
            shown = f"[{bar:<{BAR}}] {100.0 * share:3.0f} %{self._time_left(share)}  {line}"
            self._out.write(f"\r\x1b[K{shown[: columns - 1]}")
        else:
            self._out.write(f"{100.0 * share:3.0f} % {line}\n")
        self._out.flush()

    def _time_left(self, share: float) -> str:
        """As long again for each share as what is done took."""
        passed_s = self._clock() - self._begun_s
        if passed_s < SOON_S or not share > 0.0:
            return ""
        left_s = passed_s * (1.0 - share) / share
        return f", {left_s / 60.0:.0f} min left" if left_s >= 90.0 else f", {left_s:.0f} s left"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._rewrites:
            self._out.write("\r\x1b[K")
            self._out.flush()
