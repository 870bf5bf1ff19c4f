"""Ledgers: the ticks that are taken into a history, and those that are asked for."""

import random
from collections.abc import Iterable
from itertools import pairwise

import pytest

from fleet.ingest import asks
from fleet.ingest.asks import CHUNK, REPLY_S, SILENT_MAX_S, STALL_S, STALLED_MAX_S, Asks
from fleet.ingest.ledger import (
    AGREE_TICKS,
    HISTORIES_MAX,
    JUMP_MAX,
    SPANS_MAX,
    HistoryLedger,
    RigLedger,
    RigPlan,
)
from fleet.ingest.spans import Refused, Spans
from fleet.ingest.tick import Tick

START_UTC = 1.7e9
WAIT_S = 10.0


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


def tick(seq: int, history: str = "h1", utc: float | None = None, is_resend: bool = False) -> Tick:
    at = START_UTC + 60.0 * seq if utc is None else utc
    return Tick("rig-1", history, seq, at, is_resend, (), (), "")


def rig(*ticks: Tick, told: int = 0) -> RigLedger:
    """A rig whose ticks are stored."""
    own = RigLedger(10.0)
    own.load({})
    plan = RigPlan(own)
    for each in ticks:
        plan.take(each)
    plan.settle()
    own.told = told
    return own


def test_a_tick_is_new_once() -> None:
    plan = RigPlan(rig(tick(1)))
    assert [plan.take(tick(seq)) is not None for seq in (1, 2, 2, 4, 3)] == [False, True, False, True, True]
    assert list(plan.histories["h1"].stored) == [(1, 4)]


def test_nothing_changes_before_a_batch_is_stored() -> None:
    own = rig(tick(1))
    plan = RigPlan(own)
    plan.take(tick(2))
    assert list(own.histories["h1"].stored) == [(1, 1)]
    plan.settle()
    assert list(own.histories["h1"].stored) == [(1, 2)]


def test_gaps_are_those_before_within_and_after_what_is_stored() -> None:
    assert rig(tick(3), tick(4), tick(7), told=9).missing() == [(1, 2), (5, 6), (8, 9)]


def test_a_rig_of_which_nothing_is_stored_is_asked_for_all() -> None:
    assert rig(told=9).missing() == [(1, 9)]


def test_only_the_history_that_a_rig_writes_now_is_asked_for() -> None:
    own = rig(tick(2, "h1"), tick(5, "h1"), tick(1, "h2"), tick(3, "h2"), tick(4, "h1", is_resend=True))
    assert own.missing() == [(2, 2)]


def test_what_a_rig_has_not_is_asked_for_no_more_until_it_comes() -> None:
    own = rig(tick(1), tick(5))
    plan = RigPlan(own)
    plan.give_up("h1", (1, 5))
    plan.settle()
    assert own.missing() == []
    assert list(own.histories["h1"].absent) == [(2, 4)]
    plan = RigPlan(own)
    assert plan.take(tick(3))
    assert list(plan.histories["h1"].absent) == [(2, 2), (4, 4)]


def test_a_number_far_ahead_is_refused_and_asked_for_neither() -> None:
    plan = RigPlan(rig(tick(5)))
    assert plan.take(tick(5 + JUMP_MAX, utc=START_UTC))
    with pytest.raises(Refused, match="the newest before it was 1000005"):
        plan.take(tick(6 + 2 * JUMP_MAX, utc=START_UTC))
    assert rig(*(tick(seq) for seq in range(1, 6)), told=6 + JUMP_MAX).missing() == []


def test_an_old_number_with_a_new_time_is_refused() -> None:
    plan = RigPlan(rig(tick(1), tick(100)))
    assert plan.take(tick(50))
    with pytest.raises(Refused, match="later than tick 100"):
        plan.take(tick(51, utc=START_UTC + 60.0 * 200))


def test_numbers_with_gaps_everywhere_are_refused_in_the_end() -> None:
    own = HistoryLedger(Spans((3 * number, 3 * number) for number in range(1, SPANS_MAX + 1)))
    with pytest.raises(Refused, match="spans with gaps"):
        own.take(tick(3 * SPANS_MAX + 10))
    assert own.take(tick(4))  # one that lengthens a span is no burden


def test_a_rig_has_so_many_histories_and_no_more() -> None:
    plan = RigPlan(rig(*(tick(1, f"h{number}") for number in range(HISTORIES_MAX))))
    with pytest.raises(Refused, match="has had 64"):
        plan.take(tick(1, "one-more"))
    assert plan.take(tick(2, "h0"))


def test_what_the_database_has_is_the_ledger() -> None:
    own = RigLedger(10.0)
    assert own.missing() == []  # not known yet
    own.load({"old": HistoryLedger(Spans([(1, 3)])), "new": HistoryLedger(Spans([(2, 9)]))})
    assert own.current == "new"
    assert own.missing() == [(1, 1)]


FAR = 3 * JUMP_MAX


def refused_ticks(own: RigLedger, ticks: Iterable[Tick]) -> list[Tick]:
    """Give a rig ticks, a batch each; return those that it is not believed."""
    refused = []
    for each in ticks:
        plan = RigPlan(own)
        try:
            plan.take(each)
        except Refused as error:
            assert error.reason == "jump"
            refused.append(each)
        plan.settle()
    return refused


def test_numbers_that_have_jumped_and_go_on_are_the_rigs_own_again() -> None:
    own = rig(tick(1), tick(2))
    refused = refused_ticks(own, [tick(FAR + number, utc=START_UTC + number) for number in range(9)])
    assert len(refused) == AGREE_TICKS - 1 and own.missing() == []
    plan = RigPlan(own)
    taken = plan.take(tick(FAR + 9, utc=START_UTC + 9))
    assert taken is not None
    (event,) = taken.events
    assert (event.key, event.severity) == ("history.jumped", "warning")
    assert event.text == f"numbers of its ticks go on from {FAR}; the newest before was 2"
    plan.settle()
    assert list(own.histories["h1"].stored) == [(1, 2), (FAR + 9, FAR + 9)]
    assert list(own.histories["h1"].absent) == [(3, FAR - 1)]
    assert own.missing() == [(FAR, FAR + 8)]  # the refused ones, which the rig still has
    assert refused_ticks(own, [tick(FAR + number, utc=START_UTC + number) for number in range(9)]) == []
    follower = RigPlan(own).take(tick(FAR + 10, utc=START_UTC + 10))
    assert follower is not None and follower.events == ()


@pytest.mark.parametrize(
    "numbers",
    [
        [FAR + 2 * step for step in range(30)],  # none follows another
        [FAR, *range(FAR, FAR + 9), *range(2 * FAR, 2 * FAR + 9), *range(FAR, FAR + 9)],
        [FAR] * 30,
    ],
)
def test_far_numbers_that_do_not_go_on_are_never_believed(numbers: list[int]) -> None:
    own = rig(tick(1))
    assert len(refused_ticks(own, [tick(seq, utc=START_UTC + seq / 1e6) for seq in numbers])) == len(numbers)
    assert list(own.histories["h1"].stored) == [(1, 1)] and not own.histories["h1"].absent


def test_neither_resent_ticks_nor_a_clock_that_goes_back_make_a_row() -> None:
    own = rig(tick(1))
    resent = [tick(FAR + number, utc=START_UTC + number, is_resend=True) for number in range(30)]
    back = [tick(FAR + number, utc=START_UTC - number) for number in range(30)]
    assert refused_ticks(own, [*resent, *back]) == [*resent, *back]


def test_a_gap_is_asked_for_once_it_is_old() -> None:
    own = Asks(WAIT_S)
    assert own.look([(5, 8)], 0.0) is None
    assert own.look([(5, 8)], WAIT_S - 0.1) is None
    assert own.look([(5, 8)], WAIT_S) == (5, 8)
    assert own.look([(5, 8)], WAIT_S + 1.0) is None  # it has been asked


def test_an_outbox_that_empties_is_not_asked_for() -> None:
    own = Asks(WAIT_S)
    assert all(own.look([(1 + second, 5000)], float(second)) is None for second in range(100))
    assert own.look([(100, 5000)], 99.0 + WAIT_S) is not None  # until no more comes


def test_the_newest_ticks_of_the_newest_gap_come_first() -> None:
    own = Asks(0.0)
    assert own.look([(5, 8), (100, 100 + 3 * CHUNK)], 0.0) == (101 + 2 * CHUNK, 100 + 3 * CHUNK)


def test_a_rig_that_has_nothing_is_asked_for_twice_as_much() -> None:
    own, last, requests = Asks(0.0), 1_700_000_000, 0
    while last:
        span = own.look([(1, last)], float(requests))
        assert span is not None
        assert own.answer(span, 0, float(requests)) == span
        last, requests = span[0] - 1, requests + 1
    assert requests < 25


def test_an_answer_to_somebody_elses_request_says_nothing() -> None:
    own = Asks(0.0)
    assert own.look([(5, 8)], 0.0) == (5, 8)
    assert own.answer((1, 8), 0, 1.0) is None
    assert own.ask is not None
    assert Asks(0.0).answer((5, 8), 0, 1.0) is None


def test_a_silent_rig_is_asked_again_after_pauses_that_end_at_a_minute() -> None:
    assert longest_pause(answers=False) <= SILENT_MAX_S + REPLY_S + 2.0


def test_a_rig_whose_ticks_never_come_is_asked_again_at_least_each_hour() -> None:
    assert STALL_S < longest_pause(answers=True) <= STALLED_MAX_S + STALL_S + 2.0


def longest_pause(answers: bool) -> float:
    """Between two requests for one gap, of a rig that says it has it or says nothing [s]."""
    own, asked = Asks(WAIT_S), []
    for second in range(4 * 3600):
        span = own.look([(5, 8)], float(second))
        if span is not None:
            asked.append(second)
            if answers:
                own.answer(span, 4, float(second))
    return float(max(later - sooner for sooner, later in pairwise(asked)))


def test_a_gap_that_never_fills_does_not_hold_up_another() -> None:
    own = Asks(0.0)
    assert own.look([(5, 8)], 0.0) == (5, 8)
    assert own.look([(5, 8), (20, 21)], REPLY_S + 1.0) == (20, 21)


def test_ticks_that_come_keep_a_request_alive() -> None:
    own = Asks(0.0)
    assert own.look([(1, 100)], 0.0) == (1, 100)
    own.answer((1, 100), 100, 0.0)
    for second in range(100):
        assert own.look([(1 + second, 100)], STALL_S * 0.9 * second) is None
    assert own.look([], STALL_S * 90) is None
    assert own.ask is None


def test_what_is_remembered_of_failures_is_bounded() -> None:
    own = Asks(0.0)
    for number in range(3 * asks.PAUSES_MAX):
        own.look([(10 * number + 1, 10 * number + 5)], number * (REPLY_S + 1.0))
    assert len(own._pauses) <= asks.PAUSES_MAX
