"""The book of alarms: once, again until somebody has seen it, over; limits of what comes often."""

import pytest

from edge.page.alarms.alarm_book import ALARMS_MAX, DROPPED, GAP_S, OFTEN, OFTEN_S, AlarmBook, EventPlace
from edge.page.alarms.alarm_events import HistoryEvent
from edge.page.alarms.alarm_watch import RESTART_S, AlarmLook, enter
from edge.page.alarms.rig_watch import BOARD, STOP, Finding

UTC, REPEAT_S = 1.7e9, 1800.0


def said(book: AlarmBook, utc: float, channel: str = "ntfy", repeat_s: float = REPEAT_S) -> list[list[str]]:
    """Have a channel send what is due; return the causes of new, repeated and ended alarms."""
    due = book.due(channel, utc, repeat_s)
    book.note_delivery(channel, due, utc)
    return [[alarm.cause for alarm in part] for part in (due.new, due.still, due.over)]


def test_an_alarm_is_said_once_repeated_until_it_is_over_and_then_said_to_be_over() -> None:
    book = AlarmBook()
    book.begin(BOARD, "silent", UTC)
    assert said(book, UTC) == [[BOARD], [], []]
    for later_s in (1.0, REPEAT_S - 1.0):
        book.begin(BOARD, "silent", UTC + later_s)  # every look finds it again
        assert said(book, UTC + later_s) == [[], [], []]
    assert said(book, UTC + REPEAT_S) == [[], [BOARD], []]
    assert said(book, UTC + 1.5 * REPEAT_S) == [[], [], []]
    book.end(BOARD, UTC + 1.6 * REPEAT_S)
    assert said(book, UTC + 1.6 * REPEAT_S) == [[], [], [BOARD]]
    assert said(book, UTC + 9 * REPEAT_S) == [[], [], []]


def test_what_is_acknowledged_is_not_repeated_and_its_end_is_said() -> None:
    book = AlarmBook()
    book.begin(BOARD, "silent", UTC)
    said(book, UTC)
    assert book.acknowledge(1, "Ann") is not None
    book.acknowledge(1, "Bo")
    assert book.alarms[1].seen_by == "Ann"
    assert said(book, UTC + 5 * REPEAT_S) == [[], [], []]
    book.end(BOARD, UTC + 6 * REPEAT_S)
    assert said(book, UTC + 6 * REPEAT_S) == [[], [], [BOARD]]
    assert book.acknowledge(77, "Ann") is None


def test_each_channel_has_its_own_past() -> None:
    book = AlarmBook()
    book.begin(BOARD, "silent", UTC)
    said(book, UTC, "ntfy")
    assert said(book, UTC + 1.0, "mail") == [[BOARD], [], []]
    book.acknowledge(1, "Ann")
    assert said(book, UTC + 2.0, "webhook") == [[], [], []]  # somebody knows it already


def test_without_repetition_an_alarm_is_said_once_and_a_new_one_of_its_kind_again() -> None:
    book = AlarmBook()
    book.begin("history.ticks_lost", "ticks 1 to 5", UTC, EventPlace(5, 0), lasts=False)
    assert said(book, UTC, repeat_s=0.0)[0] == ["history.ticks_lost"]
    assert said(book, UTC + 10 * GAP_S, repeat_s=0.0) == [[], [], []]
    book.begin("history.ticks_lost", "ticks 7 to 9", UTC + 11 * GAP_S, EventPlace(9, 0), lasts=False)
    assert said(book, UTC + 11 * GAP_S, repeat_s=0.0) == [[], ["history.ticks_lost"], []]
    book.note_seen({(5, 0): "Ann"})
    assert book.open_causes() == {}
    book.begin("history.ticks_lost", "ticks 20 to 25", UTC + 12 * GAP_S, EventPlace(25, 0), lasts=False)
    assert said(book, UTC + 12 * GAP_S, repeat_s=0.0)[0] == ["history.ticks_lost"]


def test_an_alarm_that_came_and_went_without_a_network_is_said_afterwards() -> None:
    book = AlarmBook()
    book.begin(BOARD, "silent", UTC)
    book.end(BOARD, UTC + 60.0)
    book.forget_old(["ntfy"], UTC + 30 * OFTEN_S)
    assert said(book, UTC + 30 * OFTEN_S) == [[], [], [BOARD]]
    book.forget_old(["ntfy"], UTC + 30 * OFTEN_S)
    assert book.alarms == {}


def test_a_loose_contact_is_a_few_messages_an_hour_and_ends_with_the_truth() -> None:
    book = AlarmBook()
    messages = {"new": 0, "still": 0, "over": 0}
    for minute in range(8 * 60):  # silent every other minute, all night
        utc = UTC + 60.0 * minute
        if minute % 2:
            book.end(BOARD, utc)
        else:
            book.begin(BOARD, "silent", utc)
        for kind, part in zip(messages, said(book, utc), strict=True):
            messages[kind] += len(part)
    # New ones a start of an hour; then a return each half an hour; each with its end: not 240 of both.
    assert messages["new"] <= OFTEN * 9
    assert sum(messages.values()) <= 8 * (2 * OFTEN + 4)
    book.begin(BOARD, "silent", UTC + 9e4)  # and now it stays
    assert said(book, UTC + 9e4)[0] == [BOARD]


def test_a_return_within_the_hour_that_stays_is_said_though_the_one_before_was_acknowledged() -> None:
    book = AlarmBook()
    utc = UTC
    for _ in range(OFTEN):
        book.begin(BOARD, "silent", utc)
        said(book, utc)
        book.acknowledge(max(book.alarms), "Ann")
        book.end(BOARD, utc + 10.0)
        said(book, utc + 10.0)
        utc += 60.0
    book.begin(BOARD, "silent", utc)
    assert said(book, utc) == [[], [], []]  # it has come often
    assert said(book, utc + REPEAT_S) == [[], [BOARD], []]
    assert book.open_causes()[BOARD].times == 2


def test_an_event_acknowledged_on_the_page_is_the_alarm_acknowledged() -> None:
    book = AlarmBook()
    book.begin(BOARD, "silent", UTC)  # the page saw it first
    book.begin(BOARD, "the board has been silent for 3.0 s", UTC - 5.0, EventPlace(7, 1))
    assert len(book.alarms) == 1
    book.note_seen({(7, 0): "Bo", (7, 1): "Ann"})
    assert book.alarms[1].seen_by == "Ann"


def test_an_event_that_comes_after_the_end_of_what_the_page_saw_is_no_second_alarm() -> None:
    book = AlarmBook()
    book.begin(STOP, "pressed", UTC)
    book.end(STOP, UTC + 20.0)
    book.begin(STOP, "the board has tripped: emergency_stop", UTC + 1.0, EventPlace(3, 0))
    assert len(book.alarms) == 1
    book.begin(STOP, "the board has tripped: emergency_stop", UTC + 300.0, EventPlace(8, 0))
    assert len(book.alarms) == 2


def test_a_clock_that_is_set_back_silences_nothing() -> None:
    book = AlarmBook()
    book.begin(BOARD, "silent", UTC)
    said(book, UTC)
    assert said(book, UTC - 9e7) == [[], [BOARD], []]
    book.end(BOARD, UTC - 9e7)
    over_utc = book.alarms[1].over_utc
    assert over_utc is not None
    assert over_utc >= book.alarms[1].begun_utc


def test_the_book_is_bounded_and_says_what_it_dropped() -> None:
    book = AlarmBook()
    for number in range(3 * ALARMS_MAX):
        book.begin(f"kind.{number}", "x", UTC + number)
        book.end(f"kind.{number}", UTC + number + 0.5)
    assert len(book.alarms) <= ALARMS_MAX + 1
    dropped = book.open_causes()[DROPPED]
    assert dropped.times == 3 * ALARMS_MAX + 1 - len(book.alarms)
    assert f"kind.{3 * ALARMS_MAX - 1}" in {alarm.cause for alarm in book.alarms.values()}


# looks


def look(book: AlarmBook, *findings: Finding, utc: float = UTC, start_s: float = 1e6, **values) -> None:
    view = {"reached": True, "status": {"since_start_s": start_s}} | values.pop("view", {})
    enter(book, AlarmLook(utc, view, findings, values.get("events", ())))


def event(key: str, seq: int, text: str = "x", is_alarm: bool = True, utc: float = UTC) -> HistoryEvent:
    return HistoryEvent(EventPlace(seq, 0), utc, key, is_alarm, text)


def test_what_nobody_can_say_changes_nothing() -> None:
    book = AlarmBook()
    look(book, Finding(BOARD, None))
    assert book.alarms == {}
    look(book, Finding(BOARD, True, "silent"))
    look(book, Finding(BOARD, None))
    assert BOARD in book.open_causes()
    look(book, Finding(BOARD, False))
    assert book.open_causes() == {}


def test_all_that_is_said_of_a_silent_board_is_one_alarm_that_the_view_ends() -> None:
    book = AlarmBook()
    keys = ("board.link_lost", "board.link_down", "board.unplugged")
    events = [event(key, 1 + place) for place, key in enumerate(keys)]
    look(book, Finding(BOARD, None), events=events)
    assert list(book.open_causes()) == [BOARD]
    assert len(book.alarms) == 1
    # The history's word comes up to a tick late: it ends nothing that the view knows better.
    look(book, Finding(BOARD, True, "silent"), events=[event("board.link_down.over", 9, is_alarm=False)])
    assert BOARD in book.open_causes()
    assert len(book.alarms) == 1


def test_a_condition_ends_by_its_event_or_by_a_daemon_that_does_not_say_it_any_more() -> None:
    book = AlarmBook()
    look(book, events=[event("estimate.old", 1)])
    look(book, events=[event("estimate.old.over", 2, is_alarm=False, utc=UTC + 60.0)], utc=UTC + 61.0)
    assert book.open_causes() == {}
    look(book, events=[event("fallback.failed", 3, utc=UTC + 100.0)], utc=UTC + 101.0)
    look(book, utc=UTC + 130.0, start_s=5.0)  # a new daemon, which may say it again
    assert "fallback.failed" in book.open_causes()
    look(book, utc=UTC + 400.0, start_s=RESTART_S + 1.0)
    assert book.open_causes() == {}


def test_a_trip_is_over_when_it_is_cleared_and_not_when_the_daemon_is_silent() -> None:
    book = AlarmBook()
    look(book, Finding("safety.overheat", True, "air 44 °C"))
    look(book, view={"reached": False, "status": None})
    assert "safety.overheat" in book.open_causes()
    look(book)
    assert book.open_causes() == {}


@pytest.mark.parametrize("key", ["history.ticks_lost", "outbox.dropped"])
def test_an_event_without_an_end_waits_for_a_person(key: str) -> None:
    book = AlarmBook()
    look(book, events=[event(key, 1)])
    look(book, utc=UTC + 1e6, start_s=RESTART_S + 5.0)
    assert key in book.open_causes()
    book.note_seen({(1, 0): "Ann"})
    assert book.open_causes() == {}
