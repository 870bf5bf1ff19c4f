"""Spans against a plain set of numbers."""

import random

from fleet.ingest.spans import Spans


def spans_of(numbers: set[int]) -> list[tuple[int, int]]:
    """The spans of a set, made the slow way."""
    firsts = sorted(number for number in numbers if number - 1 not in numbers)
    lasts = sorted(number for number in numbers if number + 1 not in numbers)
    return list(zip(firsts, lasts, strict=True))


def test_spans_are_those_of_a_set_whatever_is_added_and_cut() -> None:
    random_ = random.Random(1)
    spans, numbers = Spans(), set[int]()
    for _ in range(3000):
        first = random_.randint(1, 60)
        span = (first, first + random_.choice((0, 0, 1, 5, 20)))
        if random_.random() < 0.6:
            spans.add(*span)
            numbers |= set(range(span[0], span[1] + 1))
        else:
            spans.cut(*span)
            numbers -= set(range(span[0], span[1] + 1))
        assert list(spans) == spans_of(numbers)
        assert spans.count == len(numbers)
        assert spans.newest == max(numbers, default=0)
        low, high = sorted((random_.randint(1, 80), random_.randint(1, 80)))
        assert spans.missing(low, high) == spans_of(set(range(low, high + 1)) - numbers)
        asked = random_.randint(1, 90)
        assert (asked in spans) == (asked in numbers)
        assert spans.touches(asked) == bool({asked - 1, asked, asked + 1} & numbers)


def test_a_copy_changes_apart() -> None:
    spans = Spans([(1, 5)])
    spans.copy().add(7, 7)
    assert list(spans) == [(1, 5)]
