"""Whole numbers as spans: what is stored of a history, and what is missing. Values alone."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator

from edge.core.errors import GreenhouseError

Span = tuple[int, int]  # first and last, both included


class Spans:
    """Numbers in spans that never touch, rising. A number more costs a look by bisection."""

    def __init__(self, spans: Iterable[Span] = ()) -> None:
        self._first: list[int] = []
        self._last: list[int] = []
        for first, last in spans:
            self.add(first, last)

    def __iter__(self) -> Iterator[Span]:
        return zip(self._first, self._last, strict=True)

    def __len__(self) -> int:
        """Return the number of spans."""
        return len(self._first)

    def __contains__(self, number: int) -> bool:
        place = bisect_right(self._first, number) - 1
        return place >= 0 and number <= self._last[place]

    @property
    def newest(self) -> int:
        """The largest number, 0 without any."""
        return self._last[-1] if self._last else 0

    @property
    def count(self) -> int:
        """Return the number of numbers."""
        return sum(self._last) - sum(self._first) + len(self._first)

    def copy(self) -> "Spans":
        """Return the same numbers, to be changed apart."""
        other = Spans()
        other._first, other._last = self._first.copy(), self._last.copy()
        return other

    def touches(self, number: int) -> bool:
        """Return whether the number would be in a span that is there or would lengthen one."""
        return number in self or number - 1 in self or number + 1 in self

    def add(self, first: int, last: int) -> None:
        """Add the numbers from first to last."""
        low = bisect_left(self._last, first - 1)  # spans from here on end where the new one begins, or after
        high = bisect_right(self._first, last + 1)
        if low < high:
            first, last = min(first, self._first[low]), max(last, self._last[high - 1])
        self._first[low:high], self._last[low:high] = [first], [last]

    def cut(self, first: int, last: int) -> None:
        """Take the numbers from first to last away."""
        low, high = bisect_left(self._last, first), bisect_right(self._first, last)
        left = [
            span
            for own in zip(self._first[low:high], self._last[low:high], strict=True)
            for span in ((own[0], first - 1), (last + 1, own[1]))
            if span[0] <= span[1]
        ]
        self._first[low:high], self._last[low:high] = [a for a, _ in left], [b for _, b in left]

    def missing(self, first: int, last: int) -> list[Span]:
        """Return the spans between first and last that are not here, rising."""
        low, high = bisect_left(self._last, first), bisect_right(self._first, last)
        begins = [first, *(number + 1 for number in self._last[low:high])]
        ends = [*(number - 1 for number in self._first[low:high]), last]
        return [(begin, end) for begin, end in zip(begins, ends, strict=True) if begin <= end]


class Refused(GreenhouseError):
    """Not taken in.

    reason : one word of a few, by which refusals are counted; the text is for people
    history_id, seq : of the tick, "" and 0 where the message did not say
    """

    def __init__(self, reason: str, text: str, history_id: str = "", seq: int = 0) -> None:
        super().__init__(text)
        self.reason, self.history_id, self.seq = reason, history_id, seq
