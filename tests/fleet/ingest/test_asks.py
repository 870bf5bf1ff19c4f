"""Which spans a rig is asked for, and when."""

from itertools import pairwise

from fleet.ingest import asks
from fleet.ingest.asks import CHUNK, REPLY_S, SILENT_MAX_S, STALL_S, STALLED_MAX_S, Asks

WAIT_S = 10.0


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
