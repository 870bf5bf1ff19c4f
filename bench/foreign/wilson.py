"""Shares with their intervals: how far a figure of so many cases can be trusted."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

_95 = 1.959964  # standard deviations of a normal distribution, both sides


@dataclass(frozen=True, slots=True)
class Share:
    """`hits` of `cases`; a share of no cases is NaN, and its interval says nothing: 0 to 1."""

    hits: int
    cases: int

    @property
    def value(self) -> float:
        """0..1."""
        return self.hits / self.cases if self.cases else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % (Wilson 1927, Journal of the American Statistical Association 22)."""
        if not self.cases:
            return 0.0, 1.0
        share, square = self.hits / self.cases, _95**2 / self.cases
        middle = (share + square / 2.0) / (1.0 + square)
        half = math.sqrt(share * (1.0 - share) * square + square**2 / 4.0) / (1.0 + square)
        return max(0.0, middle - half), min(1.0, middle + half)


def share(answers: Iterable[bool]) -> Share:
    """Return the share that is true."""
    given = list(answers)
    return Share(sum(given), len(given))
